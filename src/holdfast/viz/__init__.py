"""Tracks, frames and time series in Rerun, from a recording or from the live stream."""

import os

os.environ.setdefault("RUST_LOG", "off")  # the SDK's own lines on stderr: what is wrong is told in one of ours
