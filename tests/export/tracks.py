"""A track on a hill above Bern, as a replay leaves it."""

import json
from pathlib import Path

import numpy as np

from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.recording.tum import write_tum
from holdfast.state import Trajectory

DATUM = Geodetic(46.951082877, 7.438632495, 550.0)  # the origin of the Swiss grid, E 2600000 N 1200000
FRAME = LocalFrame(DATUM)
START_NS = 1_600_000_000_250_000_000


def track(count: int = 50) -> Trajectory:
    """North-east, 700 m, climbing; yaw 45 deg."""
    along = np.linspace(0.0, 500.0, count)
    half = np.pi / 8.0
    quaternions = np.tile([0.0, 0.0, np.sin(half), np.cos(half)], (count, 1))
    positions = np.column_stack([along, along, 0.02 * along])
    return Trajectory(START_NS + np.arange(count) * 100_000_000, positions, quaternions)


def folder(path: Path, datum: Geodetic | None = DATUM) -> Path:
    """Write what an export reads of a replay."""
    path.mkdir()
    keys = ("counts", "timing", "held_out", "versions", "config")
    summary = {"recording": "drive", "datum": datum and datum._asdict()} | {key: {} for key in keys}
    (path / "summary.json").write_text(json.dumps(summary))
    write_tum(path / "imu_in_world.tum", track())
    (path / "smoothed_in_world.tum").write_text("")
    return path
