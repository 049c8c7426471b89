"""Replay: a recording goes through the estimator in order of arrival, and everything that comes out is written."""
