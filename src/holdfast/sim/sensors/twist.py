"""Velocity of a frame as wheels or a camera report it: scaled, slipping, noisy."""

from math import hypot, sqrt
from typing import Any, Literal

import numpy as np
from pydantic import Field

from holdfast.config.section import quantity
from holdfast.config.sensors import Axis
from holdfast.sim.datasheets import SimulatedSensor, positive
from holdfast.sim.effects import Event, freezing, overwritten
from holdfast.sim.readings import Readings, elapsed, quantised, slow_vectors
from holdfast.sim.ros import Encode, RosMessages
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import SensorKind, register

MESSAGE = "geometry_msgs/msg/TwistWithCovarianceStamped"

UNKNOWN_VARIANCE = 1e6  # what drivers of wheels claim for an axis that they do not measure


class SimulatedTwist(SimulatedSensor):
    """Velocity of a frame in that frame, such as that of wheels: scale error, slip, noise, resolution.

    The defaults are those of wheel encoders: the radius of a tyre is known to two per cent.
    """

    kind: Literal["twist"]
    axes: tuple[Axis, ...] = Field(("x",), min_length=1, description="that it measures; of the others it reports zero")
    noise_m_s: float = quantity("m/s", 0.01, ge=0, doc="sigma of the white part, per axis")
    noise_rad_s: float = quantity("rad/s", 5e-3, ge=0, doc="sigma of the angular rates, per axis")
    scale_sigma: float = quantity("1", 0.02, ge=0, le=0.5, doc="of the scale factor, drawn once")
    slip_ratio: float = quantity("1", 0.01, ge=0, le=1, doc="sigma of the slip, in proportion to the speed")
    slip_time_constant_s: float = quantity("s", 1.0, gt=0, doc="the slip decorrelates in this time")
    resolution_m_s: float = quantity("m/s", 1e-3, ge=0, doc="velocities are multiples of it")


def measure(at: Sampling) -> Readings:
    """Return the velocity of a frame F, expressed in F.

    linear = (1 + scale) v + slip_ratio |v| m + noise, rounded to the resolution, with a Gauss-Markov process m of unit
    variance on every axis; angular = w + noise. The scale is drawn once.

    Columns:
        linear: (N, 3) [m/s].
        angular: (N, 3) [rad/s].
        covariance: (N, 6) variances in the order of ROS, linear [m^2/s^2] and angular [rad^2/s^2], without scale, slip.

    Constants:
        scale: by which the velocity is too large, as a fraction of itself.
    """
    sheet, moving, times_s, rng = at.sheet, at.moving, at.times_s, at.rng
    velocity = moving.in_frame(moving.v_W)
    scale = sheet.scale_sigma * float(rng.standard_normal())
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    slip = sheet.slip_ratio * speed * slow_vectors(rng, elapsed(times_s, sheet.slip_time_constant_s))
    noise = sheet.noise_m_s * rng.standard_normal(velocity.shape)
    linear = quantised((1.0 + scale) * velocity + slip + noise, sheet.resolution_m_s)
    is_measured = np.array([axis in sheet.axes for axis in "xyz"])
    variances = [*np.where(is_measured, sheet.noise_m_s**2, UNKNOWN_VARIANCE), *[sheet.noise_rad_s**2] * 3]
    columns = {
        "linear": np.where(is_measured, linear, 0.0),
        "angular": moving.angular_velocity + sheet.noise_rad_s * rng.standard_normal(velocity.shape),
        "covariance": np.tile(variances, (len(times_s), 1)),
    }
    return Readings(times_s, columns, {"scale": scale})


def slip(event: Event, name: str) -> Readings:
    """Add to the velocity along x a fraction of itself and a constant."""
    before, inside = event.readings[name], event.inside(name)
    linear = before.values["linear"][inside]
    spinning = (1.0 + event.fault.slip_ratio) * linear[:, 0] + event.fault.slip_m_s
    return overwritten(before, inside, {"linear": np.column_stack([spinning, linear[:, 1:]])})


def encode(ros: RosMessages, sheet: SimulatedTwist, readings: Readings) -> Encode:
    """Return what makes a geometry_msgs/TwistWithCovarianceStamped."""
    linear, angular = readings.values["linear"].tolist(), readings.values["angular"].tolist()
    variances = readings.values["covariance"]
    return lambda row, stamp_ns: ros.make(
        MESSAGE,
        header=ros.header(stamp_ns, sheet.frame),
        twist=ros.twist(linear[row], angular[row], variances[row]),
    )


def entry(sheet: SimulatedTwist) -> dict[str, Any]:
    """Return what the datasheet says, not its true errors."""
    known = {"axes": list(sheet.axes), "slip_ratio": sheet.slip_ratio, "scale_sigma": sheet.scale_sigma}
    return known | positive(sigma_m_s=hypot(sheet.noise_m_s, sheet.resolution_m_s / sqrt(12.0)))


FAULTS = {"freeze": freezing("linear", "angular"), "slip": slip}
EXAMPLE = ("wheels", {"frame": "base_link", "rate_hz": 20, "topic": "/wheels"})
register(SensorKind(SimulatedTwist, measure, MESSAGE, encode, entry, faults=FAULTS, example=EXAMPLE))
