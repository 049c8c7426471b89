"""Moves a frame of the machine in `extrinsics`, in the form in which it is written there."""

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np

from holdfast.calibration.estimated import Estimated
from holdfast.config.edit import Change
from holdfast.config.extrinsics import Extrinsic
from holdfast.config.model import Config
from holdfast.messages import Array

FORMS = ("rotation_quaternion_xyzw", "rotation_matrix", "rotation_rpy_deg")
METRES, DEGREES, UNITLESS = 4, 4, 8  # digits that are written


def entry_of(config: Config, frame: str) -> int:
    """Return the number of the entry of `extrinsics` that a frame is in."""
    return next((k for k, one in enumerate(config.extrinsics) if frame in (one.parent, one.child)), 0)


def moved(config: Config, frame: str, correction: Array) -> list[Change] | str:
    """Return the changes that make T_A_frame times a correction (4, 4) of it, for every other frame A.

    Where that cannot be said of one entry, the reason why comes back.
    """
    touching = [(k, one) for k, one in enumerate(config.extrinsics) if frame in (one.parent, one.child)]
    if len(touching) != 1:
        return f"the frame {frame!r} must be in one entry of extrinsics, and is in {len(touching)}"
    number, entry = touching[0]
    if entry.child == frame:
        return placed(("extrinsics", number), entry, entry.matrix() @ correction)
    return placed(("extrinsics", number), entry, np.linalg.inv(correction) @ entry.matrix())


def corrected(
    config: Config, frame: str, correction: Array, rows: list[Estimated]
) -> tuple[list[Estimated], list[Change]]:
    """Return what was found of a frame, and the changes by a correction (4, 4) of it if one of the rows is written.

    Where the file cannot say it in one entry, the rows keep what it says, and tell why.
    """
    changes = moved(config, frame, correction)
    if isinstance(changes, str):
        return [one.kept(changes) for one in rows], []
    return rows, changes if any(one.is_written for one in rows) else []


def placed(path: Sequence[str | int], entry: Extrinsic, T: Array) -> list[Change]:
    """Return the changes that give an entry at a path the pose (4, 4) [m]."""
    changes = []
    before = entry.matrix()
    if not np.allclose(T[:3, :3], before[:3, :3], atol=1e-9):
        form = next((form for form in FORMS if getattr(entry, form) is not None), FORMS[-1])
        changes.append(Change((*path, form), _rotation(form, gtsam.Rot3(T[:3, :3]))))
    if not np.allclose(T[:3, 3], before[:3, 3], atol=1e-6):
        changes.append(Change((*path, "translation_m"), _rounded(T[:3, 3], METRES)))
    return changes


def _rotation(form: str, R: gtsam.Rot3) -> list[float] | list[list[float]]:
    if form == "rotation_rpy_deg":
        return _rounded(np.degrees(R.rpy()), DEGREES)
    if form == "rotation_matrix":
        return [_rounded(row, UNITLESS) for row in R.matrix()]
    q: Any = R.toQuaternion()
    return _rounded(np.array([q.x(), q.y(), q.z(), q.w()]), UNITLESS)


def _rounded(values: Array, digits: int) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]
