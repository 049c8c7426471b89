"""An absolute pose as a position, for the batch of a start."""

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np

from holdfast.sensors.noise import UNBOUNDED
from holdfast.sensors.position import position_factor
from holdfast.sensors.sensor import ANYWHERE, Parameter, Position, State

POSE_CORRELATION_S = 1.0


class PoseAsPoint:
    """An absolute pose as what the batch takes: the position of the IMU itself."""

    p_I_P = np.zeros(3)
    parameters: tuple[Parameter, ...] = ()

    def __init__(self, name: str) -> None:
        self.name = name

    def factor(
        self, keys: Sequence[int], position: Position, inflation: float, _state: State = ANYWHERE
    ) -> gtsam.NonlinearFactor:
        """Return the factor of a position of the IMU itself."""
        return position_factor(keys[0], position, self.p_I_P, UNBOUNDED, inflation)


def as_position(pose: Any) -> Position:
    """Return the position that an absolute pose holds."""
    R = pose.T_F_I.rotation().matrix()
    covariance = R @ pose.covariance[3:, 3:] @ R.T
    return Position(pose.stamp_ns, pose.sensor, pose.T_F_I.translation(), covariance, POSE_CORRELATION_S)
