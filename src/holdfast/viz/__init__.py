"""Tracks, frames and time series in Rerun, from a recording or from the live stream."""
