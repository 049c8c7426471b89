"""The IMU as the guide of a lidar odometry: how the lidar turns and accelerates during and between its sweeps.

The bias of its gyroscope is found here, by the odometry itself, and not taken from the estimator: whatever the
estimator knows, it knows of GNSS too, and an odometry that has seen GNSS is no witness against it.
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


class ImuSamples(NamedTuple):
    """Readings of an IMU in I: stamps (K,) [ns], angular velocities (K, 3) [rad/s], specific forces (K, 3) [m/s^2]."""

    stamps_ns: NDArray[np.int64]
    angular: Array
    forces: Array

    @classmethod
    def of(cls, samples: Iterable[ImuSample]) -> "ImuSamples":
        """Return those of an IMU."""
        samples = list(samples)
        angular, forces = (
            np.array([getattr(sample, name) for sample in samples]).reshape(-1, 3)
            for name in ("angular_velocity", "specific_force")
        )
        return cls(np.array([sample.stamp_ns for sample in samples], np.int64), angular, forces)

    def joined(self, later: "ImuSamples") -> "ImuSamples":
        """Return these and later ones."""
        return ImuSamples(
            np.concatenate([self.stamps_ns, later.stamps_ns]),
            np.concatenate([self.angular, later.angular]),
            np.concatenate([self.forces, later.forces]),
        )

    def taken(self, chosen: NDArray[np.bool_]) -> "ImuSamples":
        """Return those that a mask (K,) chooses."""
        return ImuSamples(self.stamps_ns[chosen], self.angular[chosen], self.forces[chosen])

    def of_late(self) -> "ImuSamples":
        """Return those of the last MEMORY_NS."""
        return self.taken(self.stamps_ns >= self.stamps_ns[-1:] - MEMORY_NS) if len(self.stamps_ns) else self


NO_SAMPLES = ImuSamples(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class ImuMount:
    """How the IMU sits to the lidar, and how its gyroscope errs.

    Attributes:
        T_I_L: (4, 4) pose of the lidar in the IMU.
        offset_ns: added to the stamps of the IMU, it is the lidar's clock.
        noise_density: white noise [rad/s/sqrt(Hz)].
        random_walk: of the bias [rad/s^2/sqrt(Hz)].
        bias_sigma: of the bias at the start [rad/s].
        error_ratio: error in proportion to the rate.
    """

    T_I_L: Array
    offset_ns: int
    noise_density: float
    random_walk: float
    bias_sigma: float
    error_ratio: float


def imu_mount(config: Config, name: str) -> ImuMount:
    """Return how the primary IMU sits to the lidar whose odometry has a name in `sensors`."""
    imu, lidar = config.imu, config.sensors[name]
    return ImuMount(
        config.T_I(config.frame_of(name)),
        round((imu.time_offset_s - lidar.time_offset_s) * 1e9),
        imu.gyroscope_noise_density,
        imu.gyroscope_random_walk,
        imu.gyroscope_bias_sigma,
        imu.gyroscope_error_ratio,
    )


class InertialGuide:
    """What the IMU measures, expressed in L, on the lidar's clock, without the gyroscope's bias as known so far."""

    def __init__(self, mount: ImuMount) -> None:
        self._mount = mount
        self._R_I_L = mount.T_I_L[:3, :3]
        self._samples = NO_SAMPLES
        self.bias = np.zeros(3)
        self._variances = np.full(3, mount.bias_sigma**2)
        self._learnt_ns: int | None = None

    def add(self, samples: ImuSamples) -> None:
        """Take samples in; one whose stamp does not increase, or that is not finite, is passed over."""
        if not len(samples.stamps_ns):
            return
        newest_ns = self._samples.stamps_ns[-1:] if len(self._samples.stamps_ns) else samples.stamps_ns[:1] - 1
        before = np.maximum.accumulate(np.concatenate([newest_ns, samples.stamps_ns]))[:-1]
        finite = np.isfinite(samples.angular).all(axis=1) & np.isfinite(samples.forces).all(axis=1)
        usable = samples.taken((samples.stamps_ns > before) & finite)
        turned = ImuSamples(usable.stamps_ns, usable.angular @ self._R_I_L, usable.forces @ self._R_I_L)
        self._samples = self._samples.joined(turned).of_late()

    def rates(self, sweep: Sweep) -> Rates | None:
        """Return what it measured around a sweep, or None if it did not measure the whole sweep."""
        if not len(self._samples.stamps_ns):
            return None
        after_ns = self._samples.stamps_ns + (self._mount.offset_ns - sweep.stamp_ns)
        times_s = after_ns.astype(np.float64) * 1e-9
        offsets_s = np.zeros(1) if sweep.offsets_s is None else sweep.offsets_s
        if times_s[0] > offsets_s.min() + MAX_EXTRAPOLATION_S or times_s[-1] < offsets_s.max() - MAX_EXTRAPOLATION_S:
            return None
        lever = self._R_I_L.T @ self._mount.T_I_L[:3, 3]
        return Rates(times_s, self._samples.angular - self.bias, self._samples.forces, lever)

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
