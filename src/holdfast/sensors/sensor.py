"""What a sensor is to the estimator: it converts messages, and compares a measurement with a state.

A sensor holds no state. `Sensor` is what all have; the other protocols add what their role in the estimator asks for.
A new kind is one file with a class that has one of them, which it ends with `register`: docs/new-sensor.md builds one
from nothing.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite, radians
from typing import Any, ClassVar, NamedTuple, Protocol, TypeGuard, runtime_checkable

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import JudgedConfig, RobustLoss, SensorConfig
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import Array, GnssFix, Message, SensorPose
from holdfast.sensors.noise import UNBOUNDED, Colour, noise_model

STEADY: Array = np.zeros(6)  # [rad/s, m/s], of a twist that does not change
CHANGE_RAD, CHANGE_M = radians(0.25), 0.01  # by which a mount gives until the next day
MAX_DISTANCE_M = 1e6  # of a pose from the origin of its frame


class Role(StrEnum):
    """What a sensor's measurements do in the estimator; each role has one way into the graph."""

    POSITION = "position"  # of a point in W; the trust in all of these together decides between main and fallback
    HEADING = "heading"  # of the receiver whose fixes are positions, and doubted with them
    ODOMETRY = "odometry"  # poses that drift, joined to a track of their own
    POSE = "pose"  # a state that the estimator can start from, too
    VELOCITY = "velocity"  # of a point in W; a state like those of STATE, and a start may ask for it
    STATE = "state"  # whatever one state explains, tested one by one


class Measurement(Protocol):
    """A checked message, in the estimator's units and frames, time offset applied; measurements are their identity."""

    @property
    def stamp_ns(self) -> int:
        """Return the time of measurement on the IMU's clock."""

    @property
    def sensor(self) -> str:
        """Return the sensor's name."""


class Joint(NamedTuple):
    """The turn joint at one time: angle [rad] and rate [rad/s] of the cabin on the chassis."""

    angle_rad: float
    rate_rad_s: float


class State(NamedTuple):
    """What a measurement is compared with.

    Attributes:
        nav: attitude R_W_I, position p_W_I [m] and velocity v_W [m/s].
        covariance: (9, 9) of nav, in GTSAM's order (rotation, position, velocity, each in I).
        angular_velocity: (3,) of I, bias removed [rad/s].
        joint: the turn joint, None where there is none or where its angle is not known.
        parameter: (p,) what is estimated of the sensor, its parameters one behind the other; empty if there are none.
        parameter_covariance: (p, p).
        twist_beyond: tells by how much the mean twist (6,) of I [rad/s, m/s] over a time from here on [s] differs from
            that of now.
        acceleration: tells the mean acceleration (3,) of I over a time from here on [s], in the axes of I [m/s^2].
    """

    nav: gtsam.NavState
    covariance: Array
    angular_velocity: Array = np.zeros(3)
    joint: Joint | None = None
    parameter: Array = np.zeros(0)
    parameter_covariance: Array = np.zeros((0, 0))
    twist_beyond: Callable[[float], Array] = lambda _: STEADY
    acceleration: Callable[[float], Array] = lambda _: STEADY[:3]


ANYWHERE = State(gtsam.NavState(), np.zeros((9, 9)))  # of a factor that does not depend on where it is made


class Innovation(NamedTuple):
    """A measurement minus what a state predicts: y = z - h(x), and how it depends on the state.

    Attributes:
        y: (m,) in the measurement's units.
        H: (m, 9) derivative of h by GTSAM's tangent of the `NavState`.
        R: (m, m) covariance of the measurement.
        J: (m, p) derivative of h by the sensor's parameters; p may be 0.
    """

    y: Array
    H: Array
    R: Array
    J: Array

    def nis(self, state: State) -> float:
        """Return the normalised innovation squared, given the covariances of the state: (21) in docs/math.md."""
        return float(self.y @ np.linalg.solve(self.of_state(state) + self.R, self.y))

    def of_state(self, state: State) -> Array:
        """Return the covariance (m, m) of the prediction h(x), given those of the state and of the parameter."""
        covariance: Array = self.H @ state.covariance @ self.H.T
        if self.J.size:
            covariance += self.J @ state.parameter_covariance @ self.J.T
        return covariance


class Parameter(NamedTuple):
    """A constant of a sensor that the graph estimates, such as a scale factor.

    Attributes:
        mean: (p,) of the prior.
        sigmas: (p,) of the prior.
        if_right: (p,) sigmas that hold where the mean is right after all, inf where there is no telling. The prior is
            then a mixture of both: what was configured is either right or far off.
        shared: name of a parameter that several sensors share, such as the clock of one receiver; empty: its own.
        walk: (p,) density of the random walk by which it changes, in its units per sqrt(s); None if it is constant.
        part: what it is of the sensor, such as its lever arm, where that has several.
        change: (p,) by how much it may be another one on the next day, as sigmas; None where it is one of the world.
        has_clock: its last element is by how much the sensor's stamps are early [s].
        odds: how many times more plausible it must be that an element is off than that it is right, to let it go.
        held: of `if_right`, to which one that may be right is held: as if there were no error; 1: as it says.
    """

    mean: Array
    sigmas: Array
    if_right: Array | None = None
    shared: str = ""
    walk: Array | None = None
    part: str = ""
    change: Array | None = None
    has_clock: bool = False
    odds: float = 10.0
    held: float = 0.02

    def name(self, sensor: str) -> str:
        """Return the name under which the graph knows the parameter of a sensor."""
        return self.shared or f"{sensor} {self.part}".rstrip()


def part_of(parameters: tuple[Parameter, ...], part: str) -> Parameter | None:
    """Return what is estimated of a part of a sensor, such as its lever arm, among its parameters."""
    return next((one for one in parameters if one.part == part), None)


def is_gnss(sensor: Any) -> bool:
    """Whether a sensor is a receiver of GNSS, whatever stands before its model."""
    return getattr(sensor, "message", None) is GnssFix


@dataclass(frozen=True, slots=True, eq=False)
class Position:
    """A checked position of a point of the machine: p_W_P (3,) [m] with covariance (3, 3) [m^2], offset applied.

    Attributes:
        correlation_s: correlation time of its error.
        colour: how its error is composed, if the slow part is estimated.
    """

    stamp_ns: int
    sensor: str
    p_W_P: Array
    covariance: Array
    correlation_s: float
    colour: Colour | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Velocity:
    """A checked velocity of a point of the machine: v_W_P (3,) [m/s] with covariance (3, 3), offset applied.

    An axis that was not measured has a variance of `FREE_VARIANCE`.
    """

    stamp_ns: int
    sensor: str
    v_W_P: Array
    covariance: Array


class Sensor(Protocol):
    """One sensor of the machine; `role` says which protocol below it has, `message` what it converts, if anything.

    `parameters` are the constants of it that the graph estimates.
    """

    role: ClassVar[Role]
    message: ClassVar[type[Message] | None]
    name: str
    offset_ns: int
    parameters: tuple[Parameter, ...]

    def convert(self, message: Any, world: World) -> Any:
        """Return the measurement in a message, or the `Outcome` that says what is wrong with it.

        A point on the ellipsoid may place `world`. The message is of the kind's type, the measurement of the sensor's.
        """


class PositionSensor(Sensor, Protocol):
    """A sensor of role POSITION: `p_I_P` (3,) [m] is its lever arm, `limit` bounds the NIS.

    Where the arm is estimated it is the first of the parameters.
    """

    p_I_P: Array
    limit: float
    loss: RobustLoss

    def innovation(self, position: Position, state: State) -> Innovation:
        """Compare a position with a state."""

    def factor(
        self, keys: Sequence[int], position: Position, inflation: float, state: State = ANYWHERE
    ) -> gtsam.NonlinearFactor:
        """Return the factor on a node, and on the parameters if there are any, its covariance times `inflation`.

        `state` is the estimate of the node, which only a factor needs that depends on the angular velocity.
        """


class Comparing(Protocol):
    """What compares its measurements with one state."""

    parameters: tuple[Parameter, ...]

    def innovation(self, measurement: Any, state: State) -> Innovation | Outcome:
        """Compare a measurement with a state, or say why it cannot be compared."""


class StateSensor(Sensor, Protocol):
    """A sensor of role STATE, VELOCITY, POSE or HEADING: one state explains it, beside constants perhaps."""

    settings: JudgedConfig
    parameters: tuple[Parameter, ...] = ()

    def innovation(self, measurement: Any, state: State) -> Innovation | Outcome:
        """Compare a measurement with a state, or say why it cannot be compared."""

    def first_parameter(self, measurement: Any, state: State) -> Array:  # noqa: ARG002 (the priors' means, as a rule)
        """Return the parameters (p,) about which the first factor is linearised."""
        return np.concatenate([np.zeros(0), *(one.mean for one in self.parameters)])

    def factor(
        self, keys: Sequence[int], measurement: Any, state: State, innovation: Innovation, inflation: float
    ) -> gtsam.NonlinearFactor:
        """Return the factor of a measurement: as a rule that of its innovation, evaluated anew at each linearisation.

        Args:
            keys: that of the node and those of the parameters.
            measurement: what was measured.
            state: the estimate of node and parameters.
            innovation: of the measurement at that state.
            inflation: factor on the covariance.
        """
        return innovation_factor(self, keys, measurement, state, innovation.R * inflation)


class VelocitySensor(StateSensor, Protocol):
    """A sensor of role VELOCITY: `p_I_P` (3,) [m] is its lever arm."""

    p_I_P: Array


@runtime_checkable
class ConstraintSensor(StateSensor, Protocol):
    """A `StateSensor` without messages, whose measurements are made every `period_ns`."""

    period_ns: int

    def at(self, stamp_ns: int) -> Measurement:
        """Return the measurement at a time."""


def innovation_at(  # noqa: PLR0917 (a measurement, and the variables that it is compared with)
    sensor: Comparing, keys: Sequence[int], measurement: Any, state: State, values: gtsam.Values, size: int
) -> Innovation:
    """Return the innovation (m,) of a measurement at the values of a node and, behind it, of the parameters.

    Angular velocity and joint are those of `state`. What cannot be compared any more weighs nothing.
    """
    at = state._replace(nav=values.atNavState(keys[0]))
    if len(keys) > 1:
        at = at._replace(parameter=np.concatenate([values.atVector(key) for key in keys[1:]]))
    found = sensor.innovation(measurement, at)
    if isinstance(found, Outcome):
        return Innovation(np.zeros(size), np.zeros((size, 9)), np.eye(size), np.zeros((size, len(at.parameter))))
    return found


def by_parameter(J: Array, sizes: Iterable[int]) -> list[Array]:
    """Return a derivative (m, p) by all parameters in parts, one for each parameter of a size."""
    found, first = [], 0
    for size in sizes:
        found.append(J[:, first : first + size])
        first += size
    return found


def innovation_factor(  # noqa: PLR0917 (what a factor is made of)
    sensor: Comparing,
    keys: Sequence[int],
    measurement: Any,
    state: State,
    covariance: Array,
    loss: RobustLoss = UNBOUNDED,
) -> gtsam.NonlinearFactor:
    """Return the factor |h(x, p) - z| weighed by a covariance (m, m), with h and its derivatives from `innovation`.

    Angular velocity and joint of the state are taken as known. A measurement that cannot be compared any more weighs
    nothing.
    """
    size = len(covariance)

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        found = innovation_at(sensor, keys, measurement, state, values, size)
        if jacobians is not None:
            sizes = [values.atVector(key).size for key in keys[1:]]
            for k, by_variable in enumerate((found.H, *by_parameter(found.J, sizes))):
                jacobians[k] = by_variable
        return -found.y

    return gtsam.CustomFactor(noise_model(covariance, loss), list(keys), error)


def pose_of(message: SensorPose) -> gtsam.Pose3 | Outcome:
    """Return the pose in a message, or what is wrong with it."""
    if not (np.isfinite(message.position).all() and np.isfinite(message.quaternion).all()):
        return Outcome.NOT_FINITE
    if abs(message.position).max() > MAX_DISTANCE_M:
        return Outcome.OUT_OF_RANGE
    x, y, z, w = message.quaternion
    return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), message.position)


def is_claim(covariance: Array | None) -> TypeGuard[Array]:
    """Whether a sensor claims a covariance (m, m): one that is finite, and not zero for "unknown"."""
    if covariance is None or not isfinite(covariance.sum()):  # what is not finite makes no finite sum
        return False
    return bool(covariance.diagonal().min() > 0.0)


def claimed_covariance(claim: Array | None, floors: Array) -> Array:
    """Return the covariance (m, m) that a sensor claims, not below `floors` (m,), which stand for no claim."""
    if not is_claim(claim):
        return np.diag(floors**2)
    floored: Array = claim + np.diag(np.maximum(0.0, floors**2 - np.diag(claim)))
    return floored


Maker = Callable[[str, Any, Config], Sensor]
"""Takes a sensor's name, its section, and the configuration."""

MAKERS: dict[type[SensorConfig], Maker] = {}


def register(section: type[SensorConfig], maker: Maker) -> None:
    """Let the estimator use a kind of sensor, of which a section of the configuration makes the model."""
    MAKERS[section] = maker


def of_role(sensors: Mapping[str, Sensor], *roles: Role) -> dict[str, Any]:
    """Return the sensors of some roles, by name; each has the protocol of its role."""
    return {name: sensor for name, sensor in sensors.items() if sensor.role in roles}


def lever_arm(name: str, config: Config) -> Array:
    """Return the position (3,) of a sensor in the IMU's frame [m]."""
    return config.T_I(config.frame_of(name))[:3, 3]


def mounting(name: str, config: Config) -> gtsam.Pose3:
    """Return the pose T_I_S of a sensor in the IMU's frame."""
    return gtsam.Pose3(config.T_I(config.frame_of(name)))
