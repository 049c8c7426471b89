"""How the poses of a lidar odometry become factors of one smoother, in one of three ways.

anchored: each scan is joined to the track of its odometry, whose pose in W is a variable that drifts slowly. Scans keep
    each other in place over minutes, and say nothing of where they are: (29) in docs/math.md. The variable is the pose
    of the place on the track where an epoch begins, so that no long lever acts on it.
relative: each scan is joined to the one before (paper, IV-A.4a).
frozen: the track stays where it was when the chain was frozen, at the loss of GNSS (paper, Eq. 10).
"""

from copy import copy
from typing import Literal, NamedTuple

import gtsam
import numpy as np

from holdfast.graph.nodes import FRAME
from holdfast.graph.smoother import FREE, Smoother
from holdfast.sensors.lidar import STILL, LidarModel
from holdfast.state import Outcome

EPOCH_NS, EPOCH_M, EPOCH_RAD = 1_000_000_000, 0.4, 0.1  # the track does not drift for so long, so far, such a turn

Mode = Literal["anchored", "relative", "frozen"]


class Scan(NamedTuple):
    """A pose of the odometry at a time: that of the IMU in the frame where the IMU was when the odometry started."""

    stamp_ns: int
    T_I0_I: gtsam.Pose3


class _Epoch(NamedTuple):
    first: Scan
    key: int


class ScanChain:
    """The scans of one smoother; a scan may come late, a jump of the odometry begins a new frame."""

    def __init__(self, lidar: LidarModel, mode: Mode) -> None:
        self._lidar = lidar
        self._mode = mode
        self._newest: Scan | None = None
        self._epochs: list[_Epoch] = []
        self._made = 0
        self._T_W_I0: gtsam.Pose3 | None = None  # where the frame is frozen
        self.jumped_ns: int | None = None

    def copy(self, mode: Mode) -> "ScanChain":
        """Return a chain for a clone of the smoother, which goes on in its own way."""
        other = copy(self)
        other._epochs, other._mode = list(self._epochs), mode
        return other

    def forget(self) -> None:
        """Begin anew: the smoother lost its window, or its place."""
        self._newest, self._epochs, self._T_W_I0 = None, [], None

    @property
    def newest(self) -> Scan | None:
        """The newest scan."""
        return self._newest

    def freeze(self, smoother: Smoother) -> None:
        """Hold the frame where the newest scan sees it: T_W_I(t_j) T_I0_I(t_j)^-1, of Eq. (10) with the extrinsics."""
        if self._newest is not None and self._newest.stamp_ns >= smoother.oldest_ns:
            self._T_W_I0 = self._place(smoother, self._newest)

    def add(self, smoother: Smoother, key: int, scan: Scan) -> Outcome:
        """Join the node of a scan, which exists under `key`, to what was before."""
        before = self._newest
        motion = None
        if before is not None and before.stamp_ns < scan.stamp_ns:
            motion = before.T_I0_I.between(scan.T_I0_I)
            duration_s = (scan.stamp_ns - before.stamp_ns) * 1e-9
            if self._lidar.check_motion(motion, duration_s) is not Outcome.USED:
                self._newest = scan
                self._epochs, self._T_W_I0 = [], None
                return Outcome.OUT_OF_RANGE
            if self._is_jump(smoother, before, scan, motion):
                self.jumped_ns = scan.stamp_ns
                self._epochs, self._T_W_I0, motion = [], None, None
        if before is None or before.stamp_ns < scan.stamp_ns:
            self._newest = scan
        if self._mode == "relative":
            return self._add_relative(smoother, key, before, scan, motion)
        if self._mode == "frozen":
            return self._add_frozen(smoother, key, scan)
        return self._add_anchored(smoother, key, scan)

    def _is_jump(self, smoother: Smoother, before: Scan, scan: Scan, motion: gtsam.Pose3) -> bool:
        """Whether the IMU, which must have been heard all along, contradicts the odometry."""
        if before.stamp_ns < smoother.oldest_ns or not smoother.imu.is_believed(before.stamp_ns, scan.stamp_ns):
            return False
        predicted = smoother.nav(before.stamp_ns).pose().between(smoother.nav(scan.stamp_ns).pose())
        return self._lidar.jumped(motion, predicted)

    def _add_relative(
        self, smoother: Smoother, key: int, before: Scan | None, scan: Scan, motion: gtsam.Pose3 | None
    ) -> Outcome:
        if before is None or motion is None or scan.stamp_ns - before.stamp_ns > self._lidar.max_interval_ns:
            return Outcome.NO_PREDECESSOR
        previous_key = smoother.node(before.stamp_ns)
        if previous_key is None:
            return Outcome.NO_PREDECESSOR
        smoother.add(self._lidar.factor(previous_key, key, motion))
        return Outcome.USED

    def _add_frozen(self, smoother: Smoother, key: int, scan: Scan) -> Outcome:
        if self._T_W_I0 is None:
            self._T_W_I0 = self._place(smoother, scan)
            return Outcome.NO_PREDECESSOR
        smoother.add(self._lidar.pseudo_global_factor(key, self._T_W_I0 * scan.T_I0_I))
        return Outcome.USED

    def _add_anchored(self, smoother: Smoother, key: int, scan: Scan) -> Outcome:
        self._epochs = [epoch for epoch in self._epochs if smoother.has_frame(epoch.key)]
        at = next((epoch for epoch in reversed(self._epochs) if epoch.first.stamp_ns <= scan.stamp_ns), None)
        is_newest = bool(self._epochs) and at is self._epochs[-1]
        if not self._epochs or (is_newest and at is not None and _is_over(at, scan)):
            at = self._begin_epoch(smoother, at, scan)
        elif at is None:
            return Outcome.NO_PREDECESSOR  # from before a jump
        smoother.keep_frame(at.key, scan.stamp_ns)
        smoother.add(self._lidar.anchored_factor(at.key, key, at.first.T_I0_I.between(scan.T_I0_I)))
        return Outcome.USED

    def _begin_epoch(self, smoother: Smoother, before: _Epoch | None, scan: Scan) -> _Epoch:
        self._made += 1
        key: int = gtsam.symbol(FRAME, self._made)
        here = smoother.nav(scan.stamp_ns).pose()
        smoother.insert_frame(key, here, scan.stamp_ns)
        if before is None:
            free = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([FREE, FREE, STILL], 3))
            smoother.add(gtsam.PriorFactorNavState(key, gtsam.NavState(here, np.zeros(3)), free))
        else:
            motion = before.first.T_I0_I.between(scan.T_I0_I)
            duration_s = (scan.stamp_ns - before.first.stamp_ns) * 1e-9
            smoother.add(self._lidar.drift_factor(before.key, key, motion, duration_s))
        self._epochs.append(_Epoch(scan, key))
        return self._epochs[-1]

    def _place(self, smoother: Smoother, scan: Scan) -> gtsam.Pose3:
        """Return the pose of the odometry's frame in W as a scan sees it."""
        return smoother.nav(scan.stamp_ns).pose() * scan.T_I0_I.inverse()


def _is_over(epoch: _Epoch, scan: Scan) -> bool:
    """Whether the machine has moved on so far since an epoch began that the odometry may have drifted."""
    motion = epoch.first.T_I0_I.between(scan.T_I0_I)
    return (
        scan.stamp_ns - epoch.first.stamp_ns >= EPOCH_NS
        or float(np.linalg.norm(motion.translation())) > EPOCH_M
        or float(np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation()))) > EPOCH_RAD
    )
