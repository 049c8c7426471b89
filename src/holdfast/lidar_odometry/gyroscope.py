"""The gyroscope as the guide of a lidar odometry: the rotation of the lidar during and between its sweeps.

Its bias is found here, by the odometry itself, and not taken from the estimator: whatever the estimator knows, it knows
of GNSS too, and an odometry that has seen GNSS is no witness against it.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from holdfast.config.model import Config
from holdfast.lidar_odometry.deskew import Rates
from holdfast.lidar_odometry.registration import Registered
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.messages import Array, ImuSample

MEMORY_NS = 3_000_000_000  # of samples: scans may be late, and one may be missing
MAX_EXTRAPOLATION_S = 0.03  # a sample or two of 100 Hz that have not arrived yet
REGISTRATION_RAD = 1e-3  # sigma of the rotation between two registrations, neighbouring errors included
GATE_SIGMA = 5.0  # a registration further off has erred, or the lidar was struck


class RateSamples(NamedTuple):
    """Readings of the gyroscope: stamps (K,) [ns], and angular velocities (K, 3) of I in I [rad/s]."""

    stamps_ns: NDArray[np.int64]
    angular: Array

    @classmethod
    def of(cls, samples: Iterable[ImuSample]) -> "RateSamples":
        """Return those of an IMU."""
        samples = list(samples)
        stamps_ns = np.array([sample.stamp_ns for sample in samples], np.int64)
        return cls(stamps_ns, np.array([sample.angular_velocity for sample in samples]).reshape(-1, 3))


NO_SAMPLES = RateSamples(np.zeros(0, np.int64), np.zeros((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeMount:
    """How the gyroscope sits to the lidar, and how it errs.

    Attributes:
        R_I_L: (3, 3) axes of the lidar in those of the IMU.
        offset_ns: added to the stamps of the IMU, it is the lidar's clock.
        noise_density: white noise [rad/s/sqrt(Hz)].
        random_walk: of the bias [rad/s^2/sqrt(Hz)].
        bias_sigma: of the bias at the start [rad/s].
        error_ratio: error in proportion to the rate.
    """

    R_I_L: Array
    offset_ns: int
    noise_density: float
    random_walk: float
    bias_sigma: float
    error_ratio: float


def gyroscope_mount(config: Config, name: str) -> GyroscopeMount:
    """Return how the primary IMU sits to the lidar whose odometry has a name in `sensors`."""
    imu, lidar = config.imu, config.sensors[name]
    return GyroscopeMount(
        config.T_I(config.frame_of(name))[:3, :3],
        round((imu.time_offset_s - lidar.time_offset_s) * 1e9),
        imu.gyroscope_noise_density,
        imu.gyroscope_random_walk,
        imu.gyroscope_bias_sigma,
        imu.gyroscope_error_ratio,
    )


class Gyroscope:
    """Rates of the lidar, expressed in L, on the lidar's clock, without the bias as it is known so far."""

    def __init__(self, mount: GyroscopeMount) -> None:
        self._mount = mount
        self._stamps_ns = np.zeros(0, np.int64)
        self._angular = np.zeros((0, 3))
        self.bias = np.zeros(3)
        self._variances = np.full(3, mount.bias_sigma**2)
        self._learnt_ns: int | None = None

    def add(self, samples: RateSamples) -> None:
        """Take samples in; one whose stamp does not increase, or whose rate is not finite, is passed over."""
        newest_ns = self._stamps_ns[-1:]
        before = np.maximum.accumulate(np.concatenate([newest_ns, samples.stamps_ns]))
        rises = samples.stamps_ns > before[:-1] if len(newest_ns) else np.r_[True, samples.stamps_ns[1:] > before[:-1]]
        usable = rises[: len(samples.stamps_ns)] & np.isfinite(samples.angular).all(axis=1)
        self._stamps_ns = np.concatenate([self._stamps_ns, samples.stamps_ns[usable]])
        self._angular = np.concatenate([self._angular, samples.angular[usable] @ self._mount.R_I_L])
        if len(self._stamps_ns):
            kept = self._stamps_ns >= self._stamps_ns[-1] - MEMORY_NS
            self._stamps_ns, self._angular = self._stamps_ns[kept], self._angular[kept]

    def rates(self, sweep: Sweep) -> Rates | None:
        """Return what it measured around a sweep, or None if it did not measure the whole sweep."""
        if not len(self._stamps_ns):
            return None
        after_ns = self._stamps_ns + (self._mount.offset_ns - sweep.stamp_ns)
        times_s = after_ns.astype(np.float64) * 1e-9
        offsets_s = np.zeros(1) if sweep.offsets_s is None else sweep.offsets_s
        if times_s[0] > offsets_s.min() + MAX_EXTRAPOLATION_S or times_s[-1] < offsets_s.max() - MAX_EXTRAPOLATION_S:
            return None
        return Rates(times_s, self._angular - self.bias)

    def learn(self, before: Registered, now: Registered, sweep: Sweep, rates: Rates) -> None:
        """Correct the bias b by what two registrations say of the rotation between them, as a Kalman filter per axis.

        With R the rotation of the registrations and R_g that of the rates, less the bias so far, over the time dt, the
        innovation of b is -Log(R_g^T R) / dt.
        """
        from_s, to_s = ((one.stamp_ns - sweep.stamp_ns) * 1e-9 for one in (before, now))
        interval_s = to_s - from_s
        if not interval_s > 0.0 or rates.times_s[0] > from_s + MAX_EXTRAPOLATION_S:
            return
        measured = gtsam.Rot3(before.T_L0_L[:3, :3]).between(gtsam.Rot3(now.T_L0_L[:3, :3]))
        turned = rates.rotation(from_s, to_s)
        innovation = -gtsam.Rot3.Logmap(turned.between(measured)) / interval_s
        mount, rate = self._mount, np.abs(gtsam.Rot3.Logmap(measured)) / interval_s
        noise = mount.noise_density**2 / interval_s + (REGISTRATION_RAD / interval_s) ** 2
        noise += (mount.error_ratio * float(np.linalg.norm(rate))) ** 2
        if self._learnt_ns is not None:
            self._variances += mount.random_walk**2 * max(0.0, (now.stamp_ns - self._learnt_ns) * 1e-9)
        self._learnt_ns = now.stamp_ns
        fits = innovation**2 <= GATE_SIGMA**2 * (self._variances + noise)
        gains = np.where(fits, self._variances / (self._variances + noise), 0.0)
        self.bias = self.bias + gains * innovation
        self._variances = self._variances * (1.0 - gains)
