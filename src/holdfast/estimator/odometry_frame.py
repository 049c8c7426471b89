"""The odometry frame O: whatever the world pose does, T_O_I goes on smoothly.

T_W_O takes every correction of T_W_I at the instant at which it comes: Eq. (11) of the paper, and T_O_I does not step.
What should not stay in T_W_O flows out of it slowly afterwards: with the policy `always` its tilt, so that z of O stays
up; with `at_recovery` (the paper) everything but the corrections at recoveries.
"""

from math import radians, sqrt
from typing import Literal

import gtsam
import numpy as np

from holdfast.messages import Array

MAX_SPEED_M_S = 0.05  # at which T_O_I may flow beside the motion: 0.5 mm per sample at 100 Hz
MAX_RATE_RAD_S = radians(0.5)
SETTLE_S = 0.5  # small remainders flow out with this time constant
NEGLIGIBLE = 1e-9

Policy = Literal["always", "at_recovery"]


class OdometryFrame:
    """Keeps T_W_O."""

    def __init__(self, policy: Policy) -> None:
        self.T_W_O = gtsam.Pose3()
        self._policy = policy
        self._rest = gtsam.Pose3()  # where T_W_O rests, with the policy at_recovery
        self._flows = False

    def correct(self, before: gtsam.Pose3, after: gtsam.Pose3, *, is_recovery: bool) -> None:
        """Take in that T_W_I went from `before` to `after` at one instant."""
        self.T_W_O = after * before.inverse() * self.T_W_O
        if is_recovery:
            self._rest = self.T_W_O
        self._flows = True

    def flow(self, T_W_I: gtsam.Pose3, dt_s: float) -> None:
        """Let T_W_O approach where it rests by what is allowed in a time, T_O_I moving as little as it can."""
        if not self._flows or dt_s <= 0.0:
            return
        fraction = min(1.0, dt_s / SETTLE_S)
        if self._policy == "always":
            self._level(T_W_I, fraction, MAX_RATE_RAD_S * dt_s)
        else:
            self._approach(T_W_I, fraction, dt_s)

    def _level(self, T_W_I: gtsam.Pose3, fraction: float, most_rad: float) -> None:
        """Turn O about the machine until its z axis is up."""
        (_, _, x, _), (_, _, y, _), _, _ = self.T_W_O.matrix().tolist()  # of O's z axis in W
        tilt = sqrt(x * x + y * y)
        if tilt < NEGLIGIBLE:
            self._flows = False
            return
        by = min(fraction * tilt, most_rad) / tilt
        wx, wy = y * by, -x * by
        px, py, pz = T_W_I.translation().tolist()
        # the screw without pitch whose axis goes through the machine
        screw = np.array((wx, wy, 0.0, -pz * wy, pz * wx, px * wy - py * wx))
        self.T_W_O = gtsam.Pose3.Expmap(screw) * self.T_W_O

    def _approach(self, T_W_I: gtsam.Pose3, fraction: float, dt_s: float) -> None:
        """Move O towards its rest: first the rotation about the machine, then what moves the machine in O."""
        rotation: Array = gtsam.Rot3.Logmap(self._rest.rotation().compose(self.T_W_O.rotation().inverse()))
        angle = float(np.linalg.norm(rotation))
        if angle > NEGLIGIBLE:
            step = rotation / angle * min(fraction * angle, MAX_RATE_RAD_S * dt_s)
            self._rotate_about(T_W_I.translation(), gtsam.Rot3.Expmap(step))
        p_W_I = T_W_I.translation()
        offset_O: Array = self.T_W_O.transformTo(p_W_I) - self._rest.transformTo(p_W_I)
        distance = float(np.linalg.norm(offset_O))
        if distance > NEGLIGIBLE:
            R_W_O, step_O = self.T_W_O.rotation(), offset_O / distance * min(fraction * distance, MAX_SPEED_M_S * dt_s)
            self.T_W_O = gtsam.Pose3(R_W_O, self.T_W_O.translation() + R_W_O.rotate(step_O))
        elif angle <= NEGLIGIBLE:
            self._flows = False

    def _rotate_about(self, p_W_I: Array, rotation: gtsam.Rot3) -> None:
        """Rotate O in W about a position, which keeps its coordinates in O."""
        R_W_O = rotation.compose(self.T_W_O.rotation())
        self.T_W_O = gtsam.Pose3(R_W_O, p_W_I - R_W_O.rotate(self.T_W_O.transformTo(p_W_I)))
