"""An absolute pose, from a map matcher or a marker, in W or in a frame that is offset from it by a constant."""

from dataclasses import dataclass
from math import radians
from typing import ClassVar

import gtsam
import numpy as np

from holdfast.config.sensors import PoseConfig
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import Array, Message, SensorPose
from holdfast.sensors.sensor import (
    Innovation,
    Parameter,
    Role,
    State,
    StateSensor,
    claimed_covariance,
    mounting,
    pose_of,
    register,
)

LINEAR_SIGMAS = np.array([1e3, 1e3, 1e3, 0.2])  # in m and rad: a frame that is known so well is linearised there


@dataclass(frozen=True, slots=True, eq=False)
class FramePose:
    """A checked pose T_F_I of the IMU, time offset applied; covariance (6, 6), rotation then translation, in I."""

    stamp_ns: int
    sensor: str
    T_F_I: gtsam.Pose3
    covariance: Array


class PoseModel(StateSensor):
    """T_W_I = T_W_F T_F_I: (43) in docs/math.md; the parameter is position [m] and yaw [rad] of F in W."""

    role: ClassVar[Role] = Role.POSE
    message: ClassVar[type[Message] | None] = SensorPose

    def __init__(self, name: str, config: PoseConfig, T_I_S: gtsam.Pose3) -> None:
        self.name = name
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.settings = config
        sigmas = np.array([*[config.offset_sigma_m] * 3, radians(config.offset_sigma_deg)])
        self.parameters = (Parameter(np.zeros(4), np.maximum(sigmas, 1e-6)),) if sigmas.any() else ()
        self._T_S_I = T_I_S.inverse()
        self._adjoint: Array = T_I_S.AdjointMap()

    def convert(self, message: SensorPose, world: World) -> FramePose | Outcome:  # noqa: ARG002 (F is not on the earth)
        """Return the pose of the IMU with its noise, or what is wrong with it."""
        T_F_S = pose_of(message)
        if isinstance(T_F_S, Outcome):
            return T_F_S
        floors = np.repeat([self.settings.rotation_sigma_rad, self.settings.position_sigma_m], 3)
        covariance = claimed_covariance(message.covariance, floors)
        in_imu = self._adjoint @ covariance @ self._adjoint.T
        return FramePose(message.stamp_ns + self.offset_ns, self.name, T_F_S * self._T_S_I, in_imu)

    def first_parameter(self, measured: FramePose, state: State) -> Array:
        """Return where the first pose puts its frame in W, if that is not known well."""
        if all((one.sigmas < LINEAR_SIGMAS).all() for one in self.parameters):
            return super().first_parameter(measured, state)
        T_W_F = state.nav.pose() * measured.T_F_I.inverse()
        return np.array([*T_W_F.translation(), T_W_F.rotation().yaw()])

    def innovation(self, measured: FramePose, state: State) -> Innovation | Outcome:
        """Compare with a state: rotation and translation from the predicted to the measured pose, both in I."""
        x, y, z, yaw = state.parameter if state.parameter.size else (0.0, 0.0, 0.0, 0.0)
        R_W_F = gtsam.Rot3.Yaw(yaw)
        R_I_W = state.nav.attitude().matrix().T
        at_W = R_W_F.rotate(measured.T_F_I.translation())
        turned = R_W_F.compose(measured.T_F_I.rotation())
        between = state.nav.attitude().logmap(turned)
        shifted = R_I_W @ (at_W + np.array([x, y, z]) - state.nav.position())
        H, J = np.zeros((6, 9)), np.zeros((6, 4 if state.parameter.size else 0))
        H[:3, :3], H[3:, 3:6] = np.eye(3), np.eye(3)
        if state.parameter.size:  # z = m(parameter), so y = H dx - dm dp
            J[:3, 3] = -R_I_W[:, 2]
            J[3:, :3] = -R_I_W
            J[3:, 3] = -R_I_W @ np.array([-at_W[1], at_W[0], 0.0])
        return Innovation(np.concatenate([between, shifted]), H, measured.covariance, J)


register(PoseConfig, lambda name, section, config: PoseModel(name, section, mounting(name, config)))
