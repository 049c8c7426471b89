"""Doppler velocity of an antenna, as its receiver reports it beside the fixes."""

from math import hypot
from typing import Any, Literal

import numpy as np

from holdfast.config.section import quantity
from holdfast.sim.datasheets import correlation_s, positive
from holdfast.sim.effects import freezing
from holdfast.sim.readings import Readings, elapsed, slow_vectors
from holdfast.sim.ros import NOTHING, Encode, RosMessages
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import SensorKind, register
from holdfast.sim.sensors.gnss import OfReceiver

MESSAGE = "geometry_msgs/msg/TwistWithCovarianceStamped"

PER_AXIS = np.array([1.0, 1.0, 2.0])  # sigma up is twice that of east and north
NO_RATES = [-1.0] * 3  # variances of the angular velocity, which drivers of receivers mark so


class SimulatedGnssVelocity(OfReceiver):
    """Velocity of an antenna in east, north, up: white noise plus an error that a filter in the receiver smooths.

    The defaults are the 0.05 m/s of receivers of the u-blox F9 class; up the errors are twice as large.
    """

    kind: Literal["gnss_velocity"]
    white_m_s: float = quantity("m/s", 0.035, ge=0, doc="sigma of the white part, east and north")
    slow_m_s: float = quantity("m/s", 0.035, ge=0, doc="sigma of the slow part, east and north")
    time_constant_s: float = quantity("s", 1.0, gt=0, doc="the slow part decorrelates in this time")
    claim_ratio: float = quantity("1", 1.0, gt=0, doc="claimed sigma over the true one: 1 is an honest receiver")
    none_below: float = quantity("1", 0.12, ge=0, le=1, doc="with less open sky there is none")


def measure(at: Sampling) -> Readings:
    """Return the velocity of the antenna in W, with white and slow noise; no rows where it sees too little sky.

    Columns:
        velocity: (N, 3) east, north, up [m/s].
        sigma: (N, 3) claimed standard deviation [m/s].
    """
    sheet, times_s, rng = at.sheet, at.times_s, at.rng
    white = sheet.white_m_s * rng.standard_normal((len(times_s), 3))
    slow = sheet.slow_m_s * slow_vectors(rng, elapsed(times_s, sheet.time_constant_s))
    sigma = sheet.claim_ratio * hypot(sheet.white_m_s, sheet.slow_m_s) * PER_AXIS
    columns = {
        "velocity": at.moving.v_W + PER_AXIS * (white + slow),
        "sigma": np.tile(sigma, (len(times_s), 1)),
    }
    return Readings(times_s, columns).taken(at.scene.open_sky(sheet.frame, times_s) >= sheet.none_below)


def encode(ros: RosMessages, sheet: SimulatedGnssVelocity, readings: Readings) -> Encode:
    """Return what makes a geometry_msgs/TwistWithCovarianceStamped."""
    velocity, variances = readings.values["velocity"].tolist(), (readings.values["sigma"] ** 2).tolist()
    return lambda row, stamp_ns: ros.make(
        MESSAGE,
        header=ros.header(stamp_ns, sheet.frame),
        twist=ros.twist(velocity[row], NOTHING, variances[row] + NO_RATES),
    )


def entry(sheet: SimulatedGnssVelocity) -> dict[str, Any]:
    """Return what the datasheet says, not its true errors."""
    return positive(
        sigma_m_s=hypot(sheet.white_m_s, sheet.slow_m_s),
        correlation_s=correlation_s(sheet.white_m_s, sheet.slow_m_s, sheet.time_constant_s),
    )


FAULTS = {"freeze": freezing("velocity")}
register(SensorKind(SimulatedGnssVelocity, measure, MESSAGE, encode, entry, faults=FAULTS))
