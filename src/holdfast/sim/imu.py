"""What an inertial measurement unit reads on a known motion.

A reading is the value at its instant: nothing averages over the sample period, so that vibration above half the rate
(an engine at 28 Hz) is part of the reading, aliased as in an IMU without a filter.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedImu
from holdfast.sim.motion import FrameMotion
from holdfast.sim.readings import Readings


@dataclass(frozen=True, slots=True, eq=False)
class Bias:
    """The true bias at each sample: what was there at power-on and its random walk since; scale errors are no bias.

    Attributes:
        times_s: (N,) true time since the start of the scenario.
        accelerometer: (N, 3) in I [m/s^2].
        gyroscope: (N, 3) in I [rad/s].
    """

    times_s: Array
    accelerometer: Array
    gyroscope: Array


class _Triad(NamedTuple):
    """Datasheet of three axes of one kind, in the units of what they measure."""

    noise_density: float
    random_walk: float
    bias_sigma: float
    scale_sigma: float
    misalignment_sigma_rad: float
    full_scale: float
    resolution: float


def imu_readings(  # noqa: PLR0917 (the sensor, its motion, the earth and chance: each is needed)
    sheet: SimulatedImu,
    motion: FrameMotion,
    times_s: Array,
    gravity_m_s2: float,
    earth_rate_W: Array | None,
    rng: np.random.Generator,
) -> tuple[Readings, Bias]:
    """Return what the IMU measures, and its true bias.

    reading = (1 + scale + misalignment) truth + bias + white noise, then rounded to the resolution and cut at the
    range (the model of Groves 2013, section 4.4). Scale and misalignment are drawn once; the bias is drawn once and
    walks from there.

    Args:
        sheet: rates and errors; its `rate_hz` turns the densities into the noise of one sample.
        motion: of the IMU's frame I at `times_s`.
        times_s: (N,) regular, at `sheet.rate_hz` as from `holdfast.sim.transport.sample_times_s`.
        gravity_m_s2: normal gravity at the datum, centrifugal part included.
        earth_rate_W: (3,) angular velocity of the earth in W [rad/s], or None for an earth that stands still.
        rng: the IMU's own random numbers.

    Returns:
        Columns `angular_velocity` [rad/s] and `specific_force` [m/s^2], each (N, 3) in I; and the bias.
    """
    angular_velocity, specific_force = true_signals(motion, gravity_m_s2, earth_rate_W)
    accelerometer = _Triad(
        sheet.accelerometer_noise_density,
        sheet.accelerometer_random_walk,
        sheet.accelerometer_bias_sigma,
        sheet.accelerometer_scale_sigma,
        sheet.misalignment_sigma_rad,
        sheet.accelerometer_range,
        sheet.accelerometer_resolution,
    )
    gyroscope = _Triad(
        sheet.gyroscope_noise_density,
        sheet.gyroscope_random_walk,
        sheet.gyroscope_bias_sigma,
        sheet.gyroscope_scale_sigma,
        sheet.misalignment_sigma_rad,
        sheet.gyroscope_range,
        sheet.gyroscope_resolution,
    )
    forces, force_bias = _measured(accelerometer, specific_force, sheet.rate_hz, rng)
    rates, rate_bias = _measured(gyroscope, angular_velocity, sheet.rate_hz, rng)
    readings = Readings(times_s, {"angular_velocity": rates, "specific_force": forces})
    return readings, Bias(times_s, force_bias, rate_bias)


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
        angular_velocity = angular_velocity + _in_body(motion.R_W_F, earth_rate_W)
        acceleration = acceleration + 2.0 * np.cross(earth_rate_W, motion.v_W)
    return angular_velocity, _in_body(motion.R_W_F, acceleration)


def quantised(values: Array, resolution: float) -> Array:
    """Return values rounded to multiples of the resolution; 0 is an infinitely fine one."""
    return np.round(values / resolution) * resolution if resolution > 0.0 else values


def _in_body(R_W_F: Array, vectors_W: Array) -> Array:
    """Return R^T v for (N, 3, 3) and (3,) or (N, 3)."""
    in_body: Array = np.einsum("nji,nj->ni", R_W_F, np.broadcast_to(vectors_W, R_W_F.shape[:2]))
    return in_body


def _measured(triad: _Triad, truth: Array, rate_hz: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the readings and the bias, each (N, 3).

    White noise of a density has the sigma density * sqrt(rate) per sample, and a random walk takes steps of
    density / sqrt(rate). All numbers are drawn whatever the datasheet says, so that one error of a sensor can be
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
    # cut last: a multiple of the resolution just beyond the range is what no sensor says and every reader refuses
    return np.clip(quantised(sensed, triad.resolution), -triad.full_scale, triad.full_scale), bias
