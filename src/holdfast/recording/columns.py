"""CSV files: which columns a kind of measurement has, and what several kinds make of them.

As in `holdfast.recording.decode`, NaN passes on and what has no meaning raises `UndecodableError`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from holdfast.messages import Array, Message, SensorPose
from holdfast.recording.decode import UndecodableError, normalised

Build = Callable[[int, int, str, list[float]], Message]
"""Takes stamp [ns], arrival [ns], sensor and the values of all columns in their order, NaN for those without one."""


@dataclass(frozen=True, slots=True)
class Columns:
    """The columns of one kind of file beside its times.

    Attributes:
        required: what a file must have, in the order in which `build` takes it.
        optional: what it may have, in groups: each comes whole or not at all, and its cells may be empty.
    """

    required: tuple[str, ...]
    build: Build
    optional: tuple[tuple[str, ...], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All columns in the order in which `build` takes them."""
        return sum(self.optional, self.required)

    def missing(self, header: Sequence[str]) -> list[str]:
        """Return which columns a file with this header must have and has not."""
        begun = [group for group in self.optional if set(group) & set(header)]
        return [name for name in sum(begun, self.required) if name not in header]


def axes(pattern: str) -> tuple[str, ...]:
    """Return the names of the x, y and z column; `?` is the axis."""
    return tuple(pattern.replace("?", axis) for axis in "xyz")


def positive(sigma: float) -> float | None:
    """Return a sigma, or None where it is unknown: not finite or not positive."""
    return sigma if isfinite(sigma) and sigma > 0 else None


def diagonal(sigmas: list[float]) -> Array | None:
    """Return a diagonal covariance (3, 3), or None where it is unknown: not finite, or all zeros."""
    known = any(sigmas) and all(map(isfinite, sigmas))
    return np.diag([sigma * sigma for sigma in sigmas]) if known else None


def _pose(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> SensorPose:
    if not all(map(isfinite, v[:3])):
        raise UndecodableError("position is not finite")
    return SensorPose(stamp_ns, arrival_ns, sensor, np.array(v[:3]), normalised(np.array(v[3:])), None)


POSE_COLUMNS = Columns(("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"), _pose)
