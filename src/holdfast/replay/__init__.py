"""Replay: the estimator processes a recording in order of arrival, and all of its output is written."""
