"""What the estimator gives: estimates, optimised states, and trajectories made of stamped poses.

Covariances use GTSAM's tangent of `NavState`: rotation [rad], position [m], velocity [m/s], each expressed in the
body frame I; biases follow in GTSAM's order, accelerometer [m/s^2] before gyroscope [rad/s].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array

if TYPE_CHECKING:  # the judge and the recordings use this module without paying for the import
    import gtsam


class EncoderState(StrEnum):
    """Whether the encoder of the turn joint can be used; if it cannot, the angle goes on by the gyroscopes."""

    OK = "ok"
    ABSENT = "absent"  # no reading has come
    LATE = "late"  # it fell silent, or what comes is too old or contradicts the gyroscopes
    FROZEN = "frozen"  # it repeats a reading although the joint turns
    WRONG_ZERO = "wrong_zero"  # its zero is not where the configuration has it; the one that was learnt is used


@dataclass(frozen=True, slots=True, eq=False)
class OptimisedState:
    """The newest node of the graph after an optimisation.

    Attributes:
        nav: attitude R_W_I, position p_W_I [m] and velocity v_W [m/s].
        bias: of the accelerometer [m/s^2] and the gyroscope [rad/s].
        covariance: (15, 15) of nav and bias, in the order of this module's docstring.
        angular_velocity: (3,) of I at the node [rad/s], bias removed.
    """

    stamp_ns: int
    nav: gtsam.NavState
    bias: gtsam.imuBias.ConstantBias
    covariance: Array
    angular_velocity: Array

    def is_finite(self) -> bool:
        """Whether every number of it is."""
        rest = self.covariance, self.bias.vector(), self.angular_velocity
        return is_finite(self.nav) and all(bool(np.isfinite(values).all()) for values in rest)


def is_finite(nav: gtsam.NavState) -> bool:
    """Whether attitude, position and velocity are finite; as fast as can be, for it is asked at every sample."""
    x, y, z = nav.position().tolist()
    u, v, w = nav.bodyVelocity().tolist()  # which the attitude has turned
    return isfinite(x + y + z + u + v + w)


NAV = np.dtype([("R", np.float64, (3, 3)), ("p", np.float64, 3), ("v", np.float64, 3)])
POSE = np.dtype([("R", np.float64, (3, 3)), ("p", np.float64, 3)])
ESTIMATE = np.dtype([
    ("nav", NAV),  # R_W_I, p_W_I, v_W
    ("quaternion", np.float64, 4),  # of R_W_I, x, y, z, w
    ("T_W_O", POSE),
    ("bias_accel", np.float64, 3),
    ("bias_gyro", np.float64, 3),
    ("angular_velocity", np.float64, 3),
    ("covariance", np.float64, (9, 9)),
])  # fmt: skip
CHASSIS = np.dtype([
    ("T_O_B", POSE),
    ("T_W_B", POSE),
    ("velocity", np.float64, 3),
    ("angular_velocity", np.float64, 3),
    ("joint_angle_rad", np.float64),
    ("joint_rate_rad_s", np.float64),
    ("joint_angle_sigma_rad", np.float64),
    ("turn_rate_sigma_rad_s", np.float64),
])  # fmt: skip
PUBLISHED = np.dtype([("estimate", ESTIMATE), ("chassis", CHASSIS)])
"""What the IMU path gives at a sample, all of it doubles: `Estimate` and `BaseState` are views of one such row."""


Row = bytes | Array


def _slices(layout: np.dtype[Any], first: int = 0) -> dict[str, slice]:
    """Return where the fields of a layout lie in an array of doubles that has it from `first` on."""
    fields = {} if layout.fields is None else layout.fields
    return {name: slice(first + at // 8, first + (at + kind.itemsize) // 8) for name, (kind, at, *_) in fields.items()}


_E, _N, _B = _slices(ESTIMATE), _slices(NAV), _slices(CHASSIS, ESTIMATE.itemsize // 8)


def _pose(values: Array) -> gtsam.Pose3:
    import gtsam

    return gtsam.Pose3(gtsam.Rot3(values[:9].reshape(3, 3)), values[9:])


class Estimate(NamedTuple):
    """The state at one IMU sample: what is published.

    Attributes:
        row: the numbers, laid out as `PUBLISHED`; the properties are views of them, and cannot be written.
        from_imu: False where the IMU was silent and a constant twist stood in for it.
    """

    stamp_ns: int
    row: Row
    from_imu: bool

    @classmethod
    def of(  # noqa: PLR0917 (in the order of what it is made of)
        cls,
        stamp_ns: int,
        nav: gtsam.NavState,
        T_W_O: gtsam.Pose3,
        bias: gtsam.imuBias.ConstantBias,
        covariance: Array,
        angular_velocity: Array,
        from_imu: bool,
    ) -> Estimate:
        """Return the estimate that is made of these."""
        q: Any = nav.attitude().toQuaternion()
        quaternion = np.array([q.x(), q.y(), q.z(), q.w()]) * (1.0 if q.w() >= 0.0 else -1.0)
        state = nav.attitude().matrix(), nav.position(), nav.velocity(), quaternion
        rest = T_W_O.rotation().matrix(), T_W_O.translation(), bias.vector(), angular_velocity, covariance
        chassis = np.zeros(CHASSIS.itemsize // 8)
        return cls(stamp_ns, np.concatenate([part.ravel() for part in (*state, *rest, chassis)]), from_imu)

    @property
    def values(self) -> Array:
        """All numbers, laid out as `PUBLISHED`."""
        return np.frombuffer(self.row)

    @property
    def rotation(self) -> Array:
        """Attitude R_W_I (3, 3)."""
        return self.values[_N["R"]].reshape(3, 3)

    @property
    def quaternion(self) -> Array:
        """Attitude (4,) of I in W: x, y, z, w with w >= 0."""
        return self.values[_E["quaternion"]]

    @property
    def position(self) -> Array:
        """Position p_W_I (3,) [m]."""
        return self.values[_N["p"]]

    @property
    def velocity(self) -> Array:
        """Velocity v_W (3,) [m/s]."""
        return self.values[_N["v"]]

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity (3,) of I, bias removed [rad/s]."""
        return self.values[_E["angular_velocity"]]

    @property
    def bias_accel(self) -> Array:
        """Bias (3,) of the accelerometer [m/s^2]."""
        return self.values[_E["bias_accel"]]

    @property
    def bias_gyro(self) -> Array:
        """Bias (3,) of the gyroscope [rad/s]."""
        return self.values[_E["bias_gyro"]]

    @property
    def covariance(self) -> Array:
        """Covariance (9, 9) of the state, in the order of this module's docstring."""
        return self.values[_E["covariance"]].reshape(9, 9)

    @property
    def nav(self) -> gtsam.NavState:
        """Attitude R_W_I, position p_W_I [m] and velocity v_W [m/s]."""
        import gtsam

        return gtsam.NavState(gtsam.Rot3(self.rotation), self.position, self.velocity)

    @property
    def T_W_O(self) -> gtsam.Pose3:
        """Pose of the odometry frame in the world; T_O_I = T_W_O^-1 * T_W_I never jumps."""
        return _pose(self.values[_E["T_W_O"]])

    @property
    def bias(self) -> gtsam.imuBias.ConstantBias:
        """The biases as GTSAM has them."""
        import gtsam

        return gtsam.imuBias.ConstantBias(self.bias_accel, self.bias_gyro)


class BaseState(NamedTuple):
    """The chassis B at one estimate: (33) to (37) in docs/math.md.

    Attributes:
        row: the numbers, laid out as `PUBLISHED`; the properties are views of them, and cannot be written.
        encoder: None where there is no turn joint.
    """

    stamp_ns: int
    row: Row
    encoder: EncoderState | None

    @classmethod
    def of(  # noqa: PLR0917 (in the order of what it is made of)
        cls,
        stamp_ns: int,
        T_O_B: gtsam.Pose3,
        T_W_B: gtsam.Pose3,
        velocity: Array,
        angular_velocity: Array,
        joint: Sequence[float],
        encoder: EncoderState | None,
    ) -> BaseState:
        """Return the state that is made of these; `joint` is its angle, rate, and the two sigmas."""
        poses = [part for T in (T_O_B, T_W_B) for part in (T.rotation().matrix().ravel(), T.translation())]
        estimate = np.zeros(ESTIMATE.itemsize // 8)
        return cls(stamp_ns, np.concatenate([estimate, *poses, velocity, angular_velocity, joint]), encoder)

    @property
    def values(self) -> Array:
        """All numbers, laid out as `PUBLISHED`."""
        return np.frombuffer(self.row)

    @property
    def T_O_B(self) -> gtsam.Pose3:
        """Pose of the chassis in the odometry frame."""
        return _pose(self.values[_B["T_O_B"]])

    @property
    def T_W_B(self) -> gtsam.Pose3:
        """Pose of the chassis in the world."""
        return _pose(self.values[_B["T_W_B"]])

    @property
    def velocity(self) -> Array:
        """Velocity (3,) of B's origin, expressed in B [m/s]."""
        return self.values[_B["velocity"]]

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity (3,) of B, in B [rad/s]; what the cabin turns on the chassis is not in it."""
        return self.values[_B["angular_velocity"]]

    @property
    def joint_angle_rad(self) -> float:
        """Angle of the turn joint, beyond half a turn as well; 0 where there is none."""
        return float(self.values[-4])

    @property
    def joint_rate_rad_s(self) -> float:
        """How fast the cabin turns on the chassis."""
        return float(self.values[-3])

    @property
    def joint_angle_sigma_rad(self) -> float:
        """Standard deviation of the angle, the trust in the encoder's zero included."""
        return float(self.values[-2])

    @property
    def turn_rate_sigma_rad_s(self) -> float:
        """Standard deviation of the chassis' angular velocity about the axis of the joint."""
        return float(self.values[-1])


class Output(NamedTuple):
    """What one message led to: an estimate at an IMU sample, an optimisation, states that will not change any more.

    `base` is the state of the chassis at the estimate, if it is known.
    """

    estimate: Estimate | None = None
    optimised: OptimisedState | None = None
    smoothed: Sequence[tuple[int, gtsam.NavState]] = ()
    base: BaseState | None = None


NOTHING = Output()


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Stamped poses of one frame in another, sorted by time.

    Attributes:
        stamps_ns: (N,) strictly increasing.
        positions: (N, 3) [m].
        quaternions: (N, 4) x, y, z, w, of unit norm.
    """

    stamps_ns: NDArray[np.int64]
    positions: Array
    quaternions: Array
