"""How the lidar moves, from its own registrations and from the IMU, so that the next sweep can be predicted.

A Kalman filter over position and velocity of the IMU and gravity, in the frame L0 of the first sweep, and over the
accelerometer's bias, in the axes of L. Attitudes are taken as known: between two sweeps the gyroscope errs by less than
the accelerometer. Without an IMU the velocity is constant but for what machines accelerate by.

How much the accelerometer is believed is found from the innovations: an engine may shake it a hundred times more than
its datasheet says, and a lever that is off accelerates it, too. Nothing of this comes from the estimator, which knows
where GNSS leads it.
"""

from dataclasses import dataclass, field, replace
from typing import Self

import gtsam
import numpy as np

from holdfast.lidar_odometry.deskew import STILL, Moving, Rates
from holdfast.messages import Array

P, V, G, B = (slice(3 * k, 3 * k + 3) for k in range(4))
EYE, ZERO = np.eye(3), np.zeros((3, 3))
STEPS = 65  # of the integration between two sweeps
SPEED_M_S = 3.0  # sigma of a velocity of which nothing is known
STARTING_M_S2 = 0.5  # what a machine may accelerate by at the start, where gravity is read from the accelerometer
BIAS_M_S2 = 0.1
TILTING_M_S2 = 1e-3  # per root second: gravity turns in L0 as the map drifts
WALKING_M_S2 = 1e-3  # per root second: the bias
# white noise of accelerations [m/s^2/sqrt(Hz)]: without an IMU 1 m/s^2 for 0.2 s; with one as it is found between
# that of an IMU at rest and nothing that helps
UNMEASURED, QUIET, SHAKEN = 0.45, 0.003, 0.45
NOTHING_M2 = 1e6
STRUCK = 5.0  # an innovation so much larger, squared, than it should be
FALLS, RISES = 0.9, 1.5  # factors by which it is changed at most with a sweep


@dataclass(frozen=True, slots=True, eq=False)
class MotionFilter:
    """A state of the filter, at the instant of one sweep; immutable, so that a sweep can be tried twice.

    Attributes:
        mean: (12,) position [m], velocity [m/s], gravity [m/s^2], bias [m/s^2].
        covariance: (12, 12) of it.
        noise: white noise of the acceleration that the IMU measures [m/s^2/sqrt(Hz)].
        has_gravity: gravity has been read.
        interval_s: since the correction before.
        lever: (3,) from what moves, the IMU or else the lidar itself, to the lidar, in the axes of L [m].
    """

    mean: Array
    covariance: Array
    noise: float = 0.02
    has_gravity: bool = False
    interval_s: float = 0.0
    lever: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def beginning(cls) -> Self:
        """Return what is known at the first sweep: nothing."""
        sigmas = np.repeat([0.0, SPEED_M_S, 0.0, BIAS_M_S2], 3)
        return cls(np.zeros(12), np.diag(sigmas**2))

    def placed(self, T_L0_L: gtsam.Pose3, rates: Rates, velocity: Array = STILL) -> Self:
        """Return the filter at a pose that follows from none before, with a guess of the velocity (3,) in L0 [m/s]."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        covariance[:6], covariance[:, :6] = 0.0, 0.0
        covariance[V, V] = SPEED_M_S**2 * EYE
        mean[P], mean[V] = _position(T_L0_L, rates), velocity
        fresh = replace(self, mean=mean, covariance=covariance, has_gravity=False, lever=rates.lever)
        return fresh if rates.forces is None else fresh._with_gravity(T_L0_L, rates)

    def predicted(self, T_L0_L: gtsam.Pose3, rates: Rates, from_s: float, to_s: float) -> tuple[Self, gtsam.Pose3]:
        """Return the filter at a later instant, and the pose of the lidar then.

        Args:
            T_L0_L: pose at the earlier instant, that of the filter.
            rates: whose clock both instants [s] are on.
            from_s: the earlier instant.
            to_s: the later one.
        """
        start = self if rates.forces is None or self.has_gravity else self._with_gravity(T_L0_L, rates)
        travelled = rates.travelled(np.linspace(from_s, to_s, STEPS))
        R, dt = T_L0_L.rotation().matrix(), to_s - from_s
        F = np.eye(12)
        F[P, V] = dt * EYE
        noise = UNMEASURED
        if rates.forces is not None:
            F[P, G], F[V, G] = 0.5 * dt**2 * EYE, dt * EYE
            turned = R @ travelled.rotations.mean(axis=0)
            F[P, B], F[V, B] = -0.5 * dt**2 * turned, -dt * turned
            noise = self.noise
        mean = F @ start.mean
        mean[P] += R @ (travelled.shifts[-1] + start.lever - rates.lever)
        mean[V] += R @ travelled.velocities[-1]
        covariance = F @ start.covariance @ F.T
        _widen(covariance, noise**2 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]))
        covariance[G, G] += TILTING_M_S2**2 * dt * EYE
        covariance[B, B] += WALKING_M_S2**2 * dt * EYE
        rotation = T_L0_L.rotation().compose(gtsam.Rot3(travelled.rotations[-1]))
        position = mean[P] + rotation.matrix() @ rates.lever
        later = replace(start, mean=mean, covariance=covariance, interval_s=dt, lever=rates.lever)
        return later, gtsam.Pose3(rotation, position)

    def corrected(self, T_L0_L: gtsam.Pose3, rates: Rates, measured: Array, unheld: Array) -> Self:
        """Return the filter after a registration.

        Args:
            T_L0_L: the pose at the instant of the filter.
            rates: as for the prediction.
            measured: (3, 3) covariance of its translation, in the axes of L [m^2].
            unheld: axes (3, K) in L along which it measures nothing, orthonormal.
        """
        R = T_L0_L.rotation().matrix()
        measured = R @ (measured + NOTHING_M2 * unheld @ unheld.T) @ R.T
        innovation = _position(T_L0_L, rates) - self.mean[P]
        ratio = float(innovation @ np.linalg.solve(self.covariance[P, P] + measured, innovation)) / 3.0
        start = self
        if ratio > STRUCK and rates.forces is None:
            start = self._struck(innovation)
        elif ratio > STRUCK:  # what accelerates the lidar is measured: the registration has jumped
            measured = ratio / STRUCK * measured
        gain = np.linalg.solve(start.covariance[P, P] + measured, start.covariance[P]).T
        gain = _held(R, unheld) @ gain
        kept = np.eye(12)
        kept[:, P] -= gain
        after = kept @ start.covariance @ kept.T + gain @ measured @ gain.T
        noise = self.noise
        if rates.forces is not None:
            noise = float(np.clip(noise * np.clip(ratio**0.1, FALLS, RISES), QUIET, SHAKEN))
        return replace(self, mean=self.mean + gain @ innovation, covariance=after, noise=noise)

    def covariance_of(self, T_L0_L: gtsam.Pose3, turned_rad: float) -> Array:
        """Return the covariance (6, 6) of a predicted pose, expressed in L, whose rotation errs by an angle [rad]."""
        R = T_L0_L.rotation().matrix()
        covariance = np.diag(np.repeat([turned_rad**2, 0.0], 3))
        covariance[3:, 3:] = R.T @ self.covariance[P, P] @ R
        return covariance

    def moving(self, T_L0_L: gtsam.Pose3, rates: Rates) -> Moving:
        """Return the motion at the instant of the filter, in the axes of L."""
        R = T_L0_L.rotation().matrix()
        velocity = R.T @ self.mean[V]
        return Moving(velocity) if rates.forces is None else Moving(velocity, R.T @ self.mean[G] - self.mean[B])

    def faster_than(self, other: Self) -> Array:
        """Return by how much (3,) the velocity in L0 differs from that of another filter [m/s]."""
        difference: Array = self.mean[V] - other.mean[V]
        return difference

    def _struck(self, innovation: Array) -> Self:
        """Return the filter of a machine whose velocity has changed in a way that explains an innovation (3,) [m].

        Without an IMU a jump of the registration looks the same.
        """
        covariance, dt = self.covariance.copy(), self.interval_s
        _widen(covariance, float(innovation @ innovation) / dt**2 * np.array([[dt**2, dt], [dt, 1.0]]))
        return replace(self, covariance=covariance)

    def _with_gravity(self, T_L0_L: gtsam.Pose3, rates: Rates) -> Self:
        """Return the filter with gravity as it was read at a pose: the opposite of the mean specific force."""
        assert rates.forces is not None
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[G] = -(T_L0_L.rotation().matrix() @ (rates.forces.mean(axis=0) - mean[B]))
        covariance[G], covariance[:, G] = 0.0, 0.0
        covariance[G, G] = STARTING_M_S2**2 * EYE
        return replace(self, mean=mean, covariance=covariance, has_gravity=True)


def _widen(covariance: Array, motion: Array) -> None:
    """Add to a covariance (12, 12) that (2, 2) of position and velocity, the same along each axis."""
    covariance[:6, :6] += np.kron(motion, EYE)


def _held(R: Array, unheld: Array) -> Array:
    """Return the projection (12, 12) on what a registration measures at all.

    Which direction it does not hold is known to a degree or two, and where that leads a position that is uncertain
    along it, millimetres across it would be taken for decimetres along it.

    Args:
        R: (3, 3) axes of L in L0.
        unheld: axes (3, K) in L, orthonormal.
    """
    across = EYE - unheld @ unheld.T
    projection = np.zeros((12, 12))
    for block in (P, V, G):
        projection[block, block] = R @ across @ R.T
    projection[B, B] = across
    return projection


def _position(T_L0_L: gtsam.Pose3, rates: Rates) -> Array:
    """Return where the IMU is in L0 [m]."""
    position: Array = T_L0_L.translation() - T_L0_L.rotation().matrix() @ rates.lever
    return position
