"""A registration that never sees the machine itself."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from holdfast.errors import ConfigError
from holdfast.lidar_odometry.deskew import Moving, Rates, deskew
from holdfast.lidar_odometry.machine_mask import Boxes, MachineMask
from holdfast.lidar_odometry.registration import Registered, Registration
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.messages import Array

FEWEST_POINTS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Masking:
    """What is cut out of sweeps.

    Attributes:
        boxes: corners of parts of the machine, (3,) and (3,) each, in the lidar's frame [m].
        learning: whether the rest of the machine, its arm for one, is learnt.
    """

    boxes: Boxes = ()
    learning: bool = True


def boxes_of(corners: Sequence[Sequence[float]]) -> Boxes:
    """Return boxes of rows of two opposite corners, six numbers each [m].

    Raises:
        ConfigError: a number is not finite.
    """
    rows = [np.array(row, dtype=np.float64).reshape(2, 3) for row in corners]
    if not all(np.isfinite(row).all() for row in rows):
        raise ConfigError("--machine-box: a corner is not finite (allowed: two corners x y z x y z in metres)")
    return tuple((row.min(axis=0), row.max(axis=0)) for row in rows)


class Masked(Registration):
    """A registration before which points on the machine are cut out of each sweep."""

    def __init__(self, registration: Registration, masking: Masking) -> None:
        self._registration = registration
        self._mask = MachineMask(masking.boxes, masking.learning)
        self._before: tuple[int, gtsam.Pose3] | None = None
        self._unlearnt: tuple[Sweep, Registered] | None = None

    def register(self, sweep: Sweep) -> Registered:
        """Return where the lidar was, by what remains of the next sweep; where too little would remain, by all."""
        self.finish()
        covered = self._mask.covers(sweep.points)
        cut = covered if len(covered) - int(covered.sum()) >= FEWEST_POINTS else np.zeros_like(covered)
        registered = self._registration.register(replace(sweep.taken(~cut), own=sweep.points[cut]))
        self._unlearnt = sweep, registered
        return replace(registered, cut=float(cut.mean()) if len(cut) else 0.0)

    def finish(self) -> None:
        """Learn the machine from the last sweep."""
        self._registration.finish()
        if self._unlearnt is None:
            return
        (sweep, registered), self._unlearnt = self._unlearnt, None
        pose = gtsam.Pose3(registered.T_L0_L)
        if registered.restarted:
            self._mask.forget_places()
        elif self._mask.is_due(pose):
            self._mask.learn(self._still(sweep, registered.stamp_ns, pose), pose)
        self._before = registered.stamp_ns, pose

    def _still(self, sweep: Sweep, at_ns: int, pose: gtsam.Pose3) -> Array:
        """Return all points as from the instant of the pose."""
        if sweep.offsets_s is None or self._before is None or at_ns <= self._before[0]:
            return sweep.points
        before_ns, before = self._before
        motion, interval_s = before.between(pose), (at_ns - before_ns) * 1e-9
        constant = Rates.constant(gtsam.Rot3.Logmap(motion.rotation()) / interval_s)
        rates = constant if sweep.rates is None else sweep.rates.turning
        velocity = motion.rotation().unrotate(motion.translation()) / interval_s
        return deskew(sweep.points, sweep.offsets_s, (at_ns - sweep.stamp_ns) * 1e-9, rates, Moving(velocity))
