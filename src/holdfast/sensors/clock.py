"""A sensor whose clock is off by a constant that the graph estimates, behind the sensor's own parameters.

A measurement stamped t was taken at t + tau. Over so short a time the state moves by a twist, its mean as the IMU
measured it, so that h(x(t + tau)) = h(x) + H xi tau: (53) in docs/math.md. That holds for every sensor whose innovation
depends on attitude and position, and asks nothing of it.

So far off that this is too short, a clock is known before (90): what it stamps comes with `known_s` added, and tau goes
on from there.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import gtsam
import numpy as np

from holdfast.events import Outcome
from holdfast.messages import Array
from holdfast.sensors.sensor import (
    Innovation,
    Measurement,
    Parameter,
    Position,
    PositionSensor,
    Role,
    State,
    innovation_factor,
    is_gnss,
)

Kind = TypeVar("Kind", bound=Measurement)
CLOCK, GNSS_CLOCK = "clock", "clock of GNSS"
DELAY = "delay"  # of what is by the clock of GNSS, but computed or sent apart from positions
DELAY_S = 0.1  # sigma of a delay, where there is one: nobody has synchronised filters and drivers
IF_RIGHT_S = 5e-3  # of clocks that are synchronised: sensors have filters inside


class EstimatedClock:
    """A sensor with its offset [s] as the last of its parameters; all else is the sensor's.

    That of GNSS is one for all. What is not a position has a delay beside it, before the last, that is none or far off:
    another driver sends it, or it was filtered for longer than positions are.

    Args:
        sensor: of which an innovation and a factor are asked.
        sigma_s: of the offset.
        known_s: what of the offset is in the stamps of measurements already.
    """

    def __init__(self, sensor: Any, sigma_s: float, known_s: float = 0.0) -> None:
        self._sensor, self.known_s = sensor, known_s
        shared = GNSS_CLOCK if is_by_gnss_clock(sensor) else ""
        if_right = np.array([IF_RIGHT_S])
        clock = Parameter(
            np.zeros(1), np.array([sigma_s]), if_right, shared, part=CLOCK, change=if_right, has_clock=True
        )
        has_delay = shared and sensor.role is not Role.POSITION
        delay = (clock._replace(sigmas=np.array([DELAY_S]), shared="", part=DELAY, held=1.0),) if has_delay else ()
        self.parameters: tuple[Parameter, ...] = (*sensor.parameters, *delay, clock)
        self._own = len(delay) + 1  # how many of its parameters are of the clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensor, name)

    def first_parameter(self, measurement: Any, state: State) -> Array:
        """Return the parameters (p,) about which the first factor is linearised."""
        delays = np.zeros(self._own - 1)
        return np.concatenate([self._sensor.first_parameter(measurement, state), delays, [self.known_s]])

    def innovation(self, measurement: Any, state: State) -> Innovation | Outcome:
        """Compare a measurement with a state at the time when it was taken."""
        own = slice(None, -self._own)
        of_sensor = state._replace(
            parameter=state.parameter[own], parameter_covariance=state.parameter_covariance[own, own]
        )
        found: Innovation | Outcome = self._sensor.innovation(measurement, of_sensor)
        if isinstance(found, Outcome):
            return found
        off_s = float(state.parameter[-self._own :].sum()) - self.known_s
        twist = np.concatenate([state.angular_velocity, state.nav.bodyVelocity()]) + state.twist_beyond(off_s)
        by_offset = found.H[:, :6] @ twist
        if self._sensor.role is Role.VELOCITY:
            by_offset += found.H[:, 6:9] @ state.acceleration(off_s)
        y, J = found.y - by_offset * off_s, np.empty((len(by_offset), len(state.parameter)))
        J[:, own], J[:, -self._own :] = found.J, by_offset[:, np.newaxis]
        H = found.H.copy()
        H[:, 6:9] += off_s * H[:, 3:6]  # a velocity that is corrected carries the position over the offset, too
        return Innovation(y, H, found.R, J)

    def factor(
        self, keys: Sequence[int], measurement: Any, state: State, innovation: Innovation, inflation: float
    ) -> gtsam.NonlinearFactor:
        """Return the factor of a measurement on a node and the parameters."""
        return innovation_factor(self, keys, measurement, state, innovation.R * inflation)


class PositionClock:
    """The same of a sensor of positions, whose factor is asked for in another way."""

    def __init__(self, sensor: Any, sigma_s: float, known_s: float = 0.0) -> None:
        self._clocked = EstimatedClock(sensor, sigma_s, known_s)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._clocked, name)

    def factor(self, keys: Sequence[int], position: Position, inflation: float, state: State) -> gtsam.NonlinearFactor:
        """Return the factor of a position on a node and the parameters."""
        covariance = position.covariance * inflation
        return innovation_factor(self._clocked, keys, position, state, covariance, self._clocked.loss)


def receiver_constants(sensor: PositionSensor, value: Array) -> tuple[Array, float]:
    """Return the lever arm (3,) [m] and the offset [s] of a receiver, given what is estimated of it (p,).

    The offset is what is not in the stamps of its positions already.
    """
    if not isinstance(sensor, PositionClock):
        return sensor.p_I_P + value if value.size else sensor.p_I_P, 0.0
    shift, offset_s = value[:-1], float(value[-1]) - sensor.known_s
    return sensor.p_I_P + shift if shift.size else sensor.p_I_P, offset_s


def has_estimated_clock(sensor: Any) -> bool:
    """Whether the last of the sensor's parameters is its offset."""
    return isinstance(sensor, EstimatedClock | PositionClock)


def with_estimated_clock(sensor: Any, known_s: float = 0.0) -> Any:
    """Return a sensor with the offset of its clock to be estimated, unless the configuration says that it is known.

    `known_s` of the clock of GNSS is in the stamps of its measurements already.
    """
    sigma_s: float = getattr(sensor, "offset_sigma_s", 0.0)
    if sigma_s == 0.0:
        return sensor
    known_s = known_s if is_by_gnss_clock(sensor) else 0.0
    kind = PositionClock if sensor.role is Role.POSITION else EstimatedClock
    return kind(sensor, sigma_s, known_s)


def measured_later(measurement: Kind, by_ns: int) -> Kind:
    """Return a measurement, or a message, as one that was taken later; the same one where it is not."""
    if by_ns == 0:
        return measurement
    dated: Any = measurement
    moved: Kind = replace(dated, stamp_ns=measurement.stamp_ns + by_ns)
    return moved


def is_by_gnss_clock(sensor: Any) -> bool:
    """Whether the stamps of a sensor are as late or early as those of GNSS."""
    return sensor.role in (Role.HEADING, Role.VELOCITY) or is_gnss(sensor)
