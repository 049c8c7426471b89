"""The body of a machine and its arm, as boxes that the lidar sees: the arm moves with what the driver does.

Boom, stick and bucket hang in the plane through the cabin's x axis. Their angles follow how hard the machine works,
which tells what it does (`driver`): folded while it stands and drives, raised while it slews, stretched over the
heap, and in the trench they stroke.
"""

from typing import NamedTuple, Protocol

import numpy as np
from scipy.ndimage import gaussian_filter1d

from holdfast.messages import Array
from holdfast.sim.boxes import BoxMotion
from holdfast.sim.driver import DIGGING, DRIVING, DUMPING, IDLE, MARGIN_S, SWINGING
from holdfast.sim.movers import Arm, Part
from holdfast.sim.scene import FrameMotion

GRID_S = 0.05
SLOW_S = 0.6  # cylinders move the arm so slowly
CABIN = "cabin"
# work -> angles [deg] of the boom above the horizon, of the stick against the boom, of the bucket against the stick
POSTURES = {
    IDLE: (62.0, -125.0, -45.0),
    SWINGING: (42.0, -85.0, -60.0),
    DRIVING: (58.0, -120.0, -50.0),
    DUMPING: (36.0, -45.0, -10.0),
    DIGGING: (10.0, -75.0, -40.0),
}
STROKE_DEG = np.array([6.0, 25.0, 30.0])  # added in the trench
STROKE_S = 4.0


class Machine(Protocol):
    """A machine that moves."""

    duration_s: float

    def frame(self, name: str, times_s: Array) -> FrameMotion:
        """Return how a frame moves at true times (N,)."""

    def work(self, times_s: Array) -> Array:
        """Return how hard the machine works, (N,) from 0 to 1."""


class Parts:
    """The body and the arm of a machine."""

    def __init__(self, body: tuple[Part, ...], arm: Arm | None, machine: Machine) -> None:
        self._body, self._arm, self._machine = body, arm, machine
        self._times_s = np.arange(-MARGIN_S, machine.duration_s + MARGIN_S, GRID_S)
        self._angles = None if arm is None else _angles(machine.work(self._times_s), self._times_s)

    def at(self, times_s: Array) -> list[BoxMotion]:
        """Return the boxes in W at true times (N,)."""
        frames = {name: self._machine.frame(name, times_s) for name in {part.frame for part in self._body} | {CABIN}}
        still = np.broadcast_to(np.eye(3), (len(times_s), 3, 3))
        boxes = []
        for part in self._body:
            middle = np.broadcast_to(np.array(part.center_m), (len(times_s), 3))
            boxes.append(_placed(frames[part.frame], _Link(still, middle), np.array(part.size_m)))
        return boxes + self._links(times_s, frames[CABIN])

    def _links(self, times_s: Array, cabin: FrameMotion) -> list[BoxMotion]:
        if self._arm is None or self._angles is None:
            return []
        angles = np.stack([np.interp(times_s, self._times_s, angle) for angle in self._angles])
        joint = np.broadcast_to(np.array(self._arm.pivot_m), (len(times_s), 3))
        boxes = []
        for angle, *size in zip(
            np.cumsum(angles, axis=0), self._arm.lengths_m, self._arm.widths_m, self._arm.heights_m, strict=True
        ):
            c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
            R = np.stack([np.stack(row, -1) for row in ((c, zero, -s), (zero, one, zero), (s, zero, c))], axis=1)
            end = joint + size[0] * R[:, :, 0]
            boxes.append(_placed(cabin, _Link(R, (joint + end) / 2.0), np.array(size)))
            joint = end
        return boxes


class _Link(NamedTuple):
    """A box in a frame of the machine: (N, 3, 3) axes and (N, 3) middle [m]."""

    R: Array
    p: Array


def _placed(frame: FrameMotion, link: _Link, size: Array) -> BoxMotion:
    p_W = frame.p_W + np.einsum("nij,nj->ni", frame.R_W_F, link.p)
    return BoxMotion(frame.R_W_F @ link.R, p_W, size / 2.0)


def _angles(work: Array, times_s: Array) -> Array:
    """Return the angles (3, N) of the links, each against the one before [rad]."""
    levels = sorted(POSTURES)
    postures = np.array([POSTURES[level] for level in levels])
    degrees = np.stack([np.interp(work, levels, angle) for angle in postures.T])
    in_trench = np.clip((work - DUMPING) / (DIGGING - DUMPING), 0.0, 1.0) ** 2
    degrees += STROKE_DEG[:, None] * in_trench * np.sin(2.0 * np.pi * times_s / STROKE_S)
    return np.asarray(np.radians(gaussian_filter1d(degrees, SLOW_S / GRID_S, axis=1, mode="nearest")))
