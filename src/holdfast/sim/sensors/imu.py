"""What an inertial measurement unit reads on a known motion.

A reading is the value at its instant: nothing averages over the sample period, so that vibration above half the rate
(an engine at 28 Hz) is part of the reading, aliased as in an IMU without a filter.
"""

from math import degrees
from typing import Any, Literal, NamedTuple

import numpy as np

from holdfast.config.section import quantity
from holdfast.errors import ConfigError
from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedSensor
from holdfast.sim.effects import Event, overwritten
from holdfast.sim.readings import Readings, quantised
from holdfast.sim.ros import ABSENT, Encode, RosMessages
from holdfast.sim.scene import FrameMotion, Sampling
from holdfast.sim.sensors import SensorKind, register

MESSAGE = "sensor_msgs/msg/Imu"


class SimulatedInertial(SimulatedSensor):
    """An inertial measurement unit; densities as in Kalibr's imu.yaml (continuous time)."""

    accelerometer_noise_density: float = quantity("m/s^2/sqrt(Hz)", 1e-3, ge=0, le=1, doc="white noise")
    gyroscope_noise_density: float = quantity("rad/s/sqrt(Hz)", 1e-4, ge=0, le=1, doc="white noise")
    accelerometer_random_walk: float = quantity("m/s^3/sqrt(Hz)", 5e-5, ge=0, le=1, doc="drift of the bias")
    gyroscope_random_walk: float = quantity("rad/s^2/sqrt(Hz)", 2e-6, ge=0, le=1, doc="drift of the bias")
    accelerometer_bias_sigma: float = quantity("m/s^2", 0.03, ge=0, le=5, doc="bias at power-on")
    gyroscope_bias_sigma: float = quantity("rad/s", 2e-3, ge=0, le=1, doc="bias at power-on")
    accelerometer_scale_sigma: float = quantity("1", 5e-4, ge=0, le=0.1, doc="scale factor error per axis")
    gyroscope_scale_sigma: float = quantity("1", 5e-4, ge=0, le=0.1, doc="scale factor error per axis")
    misalignment_sigma_rad: float = quantity("rad", 5e-4, ge=0, le=0.1, doc="of the axes against each other")
    accelerometer_range: float = quantity("m/s^2", 78.0, gt=10, doc="readings saturate here")
    gyroscope_range: float = quantity("rad/s", 8.0, gt=0.1, doc="readings saturate here")
    accelerometer_resolution: float = quantity("m/s^2", 5e-4, ge=0, doc="readings are multiples of it")
    gyroscope_resolution: float = quantity("rad/s", 2e-5, ge=0, doc="readings are multiples of it")


class SimulatedImu(SimulatedInertial):
    """The inertial measurement unit that is estimated, the first if there are several; densities as in Kalibr."""

    kind: Literal["imu"]


class SimulatedBaseImu(SimulatedInertial):
    """The inertial measurement unit of the chassis; densities as in Kalibr."""

    kind: Literal["base_imu"]


class _Triad(NamedTuple):
    """Datasheet of three axes of one kind, in the units of what they measure."""

    noise_density: float
    random_walk: float
    bias_sigma: float
    scale_sigma: float
    range: float
    resolution: float
    misalignment_sigma_rad: float


def _triad(sheet: SimulatedInertial, sensor: str) -> _Triad:
    """Return the datasheet of the `accelerometer` or the `gyroscope`."""
    *own, common = _Triad._fields
    return _Triad._make([*(getattr(sheet, f"{sensor}_{name}") for name in own), getattr(sheet, common)])


def measure(at: Sampling) -> Readings:
    """Return what the IMU measures, and its true biases.

    reading = (1 + scale + misalignment) truth + bias + white noise, then rounded to the resolution and cut at the
    range (Groves 2013, section 4.4). Scale and misalignment are drawn once; the bias walks from where it was drawn.

    Columns:
        angular_velocity: (N, 3) in I [rad/s].
        specific_force: (N, 3) in I [m/s^2].
        gyroscope_bias: (N, 3) in I [rad/s]: what was there at power-on and its random walk since, without scale errors.
        accelerometer_bias: (N, 3) in I [m/s^2], likewise.
    """
    sheet: SimulatedInertial = at.sheet
    angular_velocity, specific_force = true_signals(at.moving, at.scene.gravity_m_s2, at.scene.earth_rate_W)
    forces, force_bias = _measured(_triad(sheet, "accelerometer"), specific_force, sheet.rate_hz, at.rng)
    rates, rate_bias = _measured(_triad(sheet, "gyroscope"), angular_velocity, sheet.rate_hz, at.rng)
    columns = {"angular_velocity": rates, "specific_force": forces}
    return Readings(at.times_s, columns | {"gyroscope_bias": rate_bias, "accelerometer_bias": force_bias})


def true_signals(motion: FrameMotion, gravity_m_s2: float, earth_rate_W: Array | None) -> tuple[Array, Array]:
    """Return angular velocity [rad/s] against inertial space and specific force [m/s^2], each (N, 3) in I.

    w = w_WI + R^T W and f = R^T (a + 2 W x v - g), W the earth rate: the navigation equations in a frame that is fixed
    to the earth (Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd edition 2013,
    section 5.3). Gravity contains the centrifugal acceleration, which therefore is no term of its own; it is taken as
    (0, 0, -g) all over the site: over 100 m the plumb line turns by 1.6e-5 rad.
    """
    angular_velocity = motion.angular_velocity
    acceleration = motion.a_W + np.array([0.0, 0.0, gravity_m_s2])
    if earth_rate_W is not None:
        angular_velocity = angular_velocity + motion.in_frame(earth_rate_W)
        acceleration = acceleration + 2.0 * np.cross(earth_rate_W, motion.v_W)
    return angular_velocity, motion.in_frame(acceleration)


def _measured(triad: _Triad, truth: Array, rate_hz: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the readings and the bias, each (N, 3).

    White noise of a density has the sigma density * sqrt(rate) per sample, and a random walk takes steps of
    density / sqrt(rate). All numbers are drawn whatever the datasheet contains, so that one error of a sensor can be
    switched off and the others stay the same.
    """
    scale = triad.scale_sigma * rng.standard_normal(3)
    misalignment = triad.misalignment_sigma_rad * rng.standard_normal((3, 3))
    np.fill_diagonal(misalignment, 0.0)
    bias = triad.random_walk / np.sqrt(rate_hz) * rng.standard_normal(truth.shape)
    bias[:1] = triad.bias_sigma * rng.standard_normal(3)
    bias = np.cumsum(bias, axis=0)
    noise = triad.noise_density * np.sqrt(rate_hz) * rng.standard_normal(truth.shape)
    sensed = truth @ (np.eye(3) + np.diag(scale) + misalignment).T + bias + noise
    # cut last: a multiple of the resolution just beyond the range is what no sensor reports and every reader refuses
    return np.clip(quantised(sensed, triad.resolution), -triad.range, triad.range), bias


def line(event: Event, name: str) -> Readings:
    """Draw lines between the last sample before and the first one after; at an end of the recording, level ones."""
    before, inside = event.readings[name], event.inside(name)
    if inside.all():
        raise ConfigError(f"faults: the line at {event.fault.start_s:g} s leaves no sample of {name} to start from")
    lines = {}
    for column in ("angular_velocity", "specific_force"):  # the others are truth
        axes = before.values[column].T
        drawn = [np.interp(before.times_s[inside], before.times_s[~inside], axis[~inside]) for axis in axes]
        lines[column] = np.stack(drawn, axis=1)
    return overwritten(before, inside, lines)


def encode(ros: RosMessages, sheet: SimulatedInertial, readings: Readings) -> Encode:
    """Return what makes the sensor_msgs/Imu of an inertial measurement unit."""
    rates, forces = readings.values["angular_velocity"].tolist(), readings.values["specific_force"].tolist()
    no_orientation = ros.quaternion((0.0, 0.0, 0.0, 1.0))
    of_rate = np.eye(3).ravel() * sheet.gyroscope_noise_density**2 * sheet.rate_hz
    of_force = np.eye(3).ravel() * sheet.accelerometer_noise_density**2 * sheet.rate_hz
    return lambda row, stamp_ns: ros.make(
        MESSAGE,
        header=ros.header(stamp_ns, sheet.frame),
        orientation=no_orientation,
        orientation_covariance=ABSENT,
        angular_velocity=ros.vector(rates[row]),
        angular_velocity_covariance=of_rate,
        linear_acceleration=ros.vector(forces[row]),
        linear_acceleration_covariance=of_force,
    )


def entry(sheet: SimulatedInertial) -> dict[str, Any]:
    """Return the densities, biases and ranges of the datasheet."""
    known = ("noise_density", "random_walk", "bias_sigma", "range")
    return {
        (key := f"{sensor}_{name}"): getattr(sheet, key) for name in known for sensor in ("accelerometer", "gyroscope")
    }


def base_entry(sheet: SimulatedInertial) -> dict[str, Any]:
    """Return the same and how well the directions of its axes are known: the housing is mounted as in `extrinsics`."""
    return entry(sheet) | {"mounting_sigma_deg": degrees(sheet.misalignment_sigma_rad)}


for _sheet, _entry in ((SimulatedImu, entry), (SimulatedBaseImu, base_entry)):
    register(SensorKind(_sheet, measure, MESSAGE, encode, _entry, faults={"line": line}))
