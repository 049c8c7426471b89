"""Which directions a scan holds: a tunnel holds no motion along itself, an open field neither position nor heading.

A point on a plane measures the motion across it: J = [p x n; n] of the tangent of L, rotation first. A is the sum of
w J J^T. A normal that is fitted to neighbours with noise s errs by s / sqrt(k l) about each axis of the plane, l the
variance of the neighbours along it, and so pretends to hold directions that it does not: B is what such errors add to A
by themselves. The eigenvalues of A against B say how many times more a direction is held than by noise alone. They have
no unit, so rotation and translation need no common scale, and it is 1 in a direction that nothing holds: decision 032.
Directions below UNHELD are taken from the guess (solution remapping; Zhang, Kaess and Singh 2016, with B
in the place of their threshold).
"""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import small_gicp

from holdfast.lidar_odometry.planes import NEIGHBOURS, Planes, are_lines, spread
from holdfast.messages import Array

UNHELD = 3.0  # it is 0 to 3 along smooth walls, 3 to 8 in a wood, 6 to 50 on a site or a yard with three containers
HELD_AGAIN = 5.0  # what was lost is held from here on, if two sweeps say so: one of hundreds says it of a smooth wall
WEAK = 15.0  # below, thick planes pull by more than is known of the motion otherwise
LEVER_M = 10.0  # a direction that moves the lidar less than points at this distance is one of its attitude
SAMPLES = 2000
FINEST_M = 0.002  # the noise of thinned points is that of their neighbourhood, and not less than this
RANGE_NOISE_M = 0.02  # of the usual lidar; a surface is not smoother than that
ROUNDING = 1e-12  # of a variance
CORRECTED_M = 0.1  # by so much sweeps correct a guess, if they do
THICKNESS = 1e-3  # a registration of thick planes pulls along them, too, towards the pattern of the sweep before
MIXED = 0.1  # of that pull where no sweep has the pattern of the one before
PARTNER_M = 1.0  # a point without the sweep before it nearby has nothing in the map yet that it could be held by
# what the guess may miss: machines brake with less than 1 m/s^2 and are slower than 10 m/s; gyroscopes are biased by
# less than 0.005 rad/s; without one, a cabin starts to slew with 0.6 rad/s^2
ACCELERATION_M_S2, SPEED_M_S, VELOCITY_SIGMA_M_S = 1.0, 10.0, 0.05
ANGULAR_ACCELERATION_RAD_S2, RATE_RAD_S, GYROSCOPE_RAD_S = 0.6, 1.0, 0.005


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """What a scan holds.

    Attributes:
        directions: (6, 6) of the tangent of L in columns, rotation [rad] then translation [m]; V^T B V = 1.
        duals: (6, 6) columns B V: the parts of a motion are W^T x.
        ratios: (6,) how many times more each is held than by noise, increasing.
        least: the ratio from which on a direction counts as held.
        mixed: factor of the pull of thick planes; 1 where every sweep has the pattern of the one before.
    """

    directions: Array
    duals: Array
    ratios: Array
    least: float = UNHELD
    mixed: float = 1.0

    @property
    def unheld(self) -> int:
        """The number of directions that are not held."""
        return int((self.ratios < self.least).sum())

    @property
    def unheld_axes(self) -> Array:
        """Axes (3, K) in L along which the scan does not hold the lidar, whatever it holds of its attitude."""
        turns, shifts = self.directions[:3], self.directions[3:]
        moves = np.linalg.norm(shifts, axis=0) > LEVER_M * np.linalg.norm(turns, axis=0)
        axes: Array = np.linalg.qr(shifts[:, moves & (self.ratios < self.least)])[0]
        return axes

    def with_unheld(self, count: int) -> Self:
        """Return the same with so many directions not held."""
        return replace(self, least=float(np.append(self.ratios, np.inf)[count]))

    def doubted(self, motion: Array) -> Array:
        """Return the sigmas (6,) of what thick planes pull by along the directions, towards no motion.

        What is held with r times the weight of the pull is off by 1 / (1 + r) of the motion. In one sweep the pull may
        be as large as in any, also where the mean over patterns is smaller.

        Args:
            motion: (6,) since the pose before.
        """
        pulled = 1.0 / (1.0 + self.mixed * np.clip(self.ratios, 0.0, WEAK))
        doubted: Array = (pulled - 1.0 / (1.0 + self.mixed * WEAK)) * np.abs(self.duals.T @ motion)
        return doubted

    def held_part(self, correction: Array, guess: Array, doubted: Array) -> Array:
        """Return the part of a correction (6,) of the guess that follows from what the scan measures.

        Of what is in doubt, as much as the guess is in more. Where directions are not held, a Kalman update of the
        guess: a turn that cannot be told from a shift is left to the gyroscope. Seen from a lidar that looks ahead
        most turns are such.

        Args:
            correction: from the guess to the registration.
            guess: (6, 6) covariance of the guess.
            doubted: (6,) sigmas along the directions.
        """
        held = self.ratios >= self.least
        if held.all():
            variances = self._along(guess)
            whole: Array = self.directions @ (variances / (variances + doubted**2) * (self.duals.T @ correction))
            return whole
        W = self.duals[:, held]
        shared = _limited(guess) @ W
        innovation = W.T @ shared
        measured = innovation + np.diag(doubted[held] ** 2 + ROUNDING * innovation.diagonal())
        part: Array = shared @ np.linalg.solve(measured, W.T @ correction)
        return part

    def covariance(self, registered: Array, unheld: Array, doubted: Array) -> Array:
        """Return the covariance (6, 6) of a pose: that of the registration, more where it is in doubt or holds nothing.

        Rotation and translation that are not held are taken for independent. A direction along a tunnel turns the lidar
        by a milliradian a metre, too, by chance: claimed, that would be information, since a gyroscope knows the turn.

        Args:
            registered: (6, 6) covariance of the registration.
            unheld: (6, 6) covariance in directions that it does not hold.
            doubted: (6,) sigmas along the others.
        """
        if not doubted.any() and not self.unheld:
            return registered
        held = self.ratios >= self.least
        V, D, W = self.directions[:, held], self.directions[:, ~held], self.duals[:, ~held]
        inner = np.linalg.inv(V.T @ np.linalg.solve(registered, V)) + np.diag(doubted[held] ** 2)
        guessed = D @ (W.T @ unheld @ W) @ D.T
        guessed[:3, 3:] = guessed[3:, :3] = 0.0
        covariance: Array = V @ inner @ V.T + guessed
        return (covariance + covariance.T) / 2.0

    def joined(self, doubted: Array, guess: Array) -> Array:
        """Return the sigmas (6,) of a guess (6, 6) that is corrected by what is in doubt."""
        variances = self._along(guess)
        sigmas: Array = doubted * np.sqrt(variances / (variances + doubted**2))
        return sigmas

    def _along(self, covariance: Array) -> Array:
        """Return the variances (6,) along the directions."""
        variances: Array = np.einsum("ji,jk,ki->i", self.duals, covariance, self.duals)
        return variances


@dataclass(slots=True)
class Degeneracy:
    """Looks at sweep after sweep; it knows the one before, and since when the guess has gone on alone.

    Attributes:
        unheld_s: how long not all directions have been held.
    """

    unheld_s: float = 0.0
    _before: small_gicp.KdTree | None = field(default=None, repr=False)
    _loose: int = 0  # directions of the sweep before that would not be held again

    def look(self, planes: Planes, motion: Array, pattern_repeats: bool = True) -> Observability:
        """Return what a sweep holds, of the points near which there was one in the sweep before.

        Args:
            planes: of the sweep, thinned, in L.
            motion: (4, 4) pose of L in the L of the sweep before.
            pattern_repeats: the rays go the same ways in every sweep.
        """
        before, self._before = self._before, planes.tree
        points = planes.points
        sampled = points[:: max(1, len(points) // SAMPLES)]
        if before is not None:
            there = sampled @ motion[:3, :3].T + motion[:3, 3]
            sampled = sampled[before.batch_knn_search(there, 1)[1][:, 0] < PARTNER_M**2]
        mixed = 1.0 if pattern_repeats else MIXED
        found = observability(sampled, planes.neighbourhoods(sampled), mixed)
        loose, self._loose = self._loose, int((found.ratios < HELD_AGAIN).sum())
        return found.with_unheld(max(loose, self._loose)) if self.unheld_s > 0.0 else found

    def guess_covariance(self, interval_s: float, found: Observability, has_gyroscope: bool) -> Array:
        """Return the covariance (6, 6) of the guessed motion over an interval, and count how long it goes on.

        Errors of the guess add up: an acceleration that it misses makes a velocity that lasts. Each interval claims
        what the bound D grows in it, D(t)^2 - D(t - dt)^2, so that independent claims sum to D^2.
        """
        before_s = self.unheld_s
        self.unheld_s = before_s + interval_s if found.unheld else 0.0
        after_s = before_s + interval_s
        shift = _distance_m(after_s) ** 2 - _distance_m(before_s) ** 2
        turn = _angle_rad(after_s, has_gyroscope) ** 2 - _angle_rad(before_s, has_gyroscope) ** 2
        return np.diag(np.repeat([turn, shift], 3))


def observability(points: Array, neighbours: Array, mixed: float = 1.0) -> Observability:
    """Return what points hold.

    Args:
        points: (N, 3) in L [m].
        neighbours: (N, k, 3) the points around each, nearest first [m]. The first NEIGHBOURS are used, and all where
            those lie on a line: what is small and yet has many points holds more than a wide plane says.
        mixed: factor of THICKNESS, by how much of what a plane is held across itself it is pulled along itself.
    """
    variances, frames = spread(neighbours[:, :NEIGHBOURS])
    wider = are_lines(variances) & (neighbours.shape[1] > NEIGHBOURS)
    variances[wider], frames[wider] = spread(neighbours[wider])
    count = np.where(wider, neighbours.shape[1], NEIGHBOURS)
    noise = np.maximum(variances[:, 0] * count / (count - 3), FINEST_M**2)
    weights = RANGE_NOISE_M**2 / np.maximum(noise, RANGE_NOISE_M**2)
    held = _information(points, frames[:, :, 0], weights)
    pull = np.zeros((6, 6))
    for axis in (1, 2):
        across = np.maximum(variances[:, axis], noise)
        tilt = np.clip(noise * across / (count * np.maximum(across - noise, 1e-9) ** 2), 0.0, 1.0)
        held -= _information(points, frames[:, :, axis], weights * tilt)
        pull += _information(points, frames[:, :, axis], weights * np.maximum(tilt, mixed * THICKNESS))
    pull += max(1e-9 * np.trace(pull), 1e-12) * np.eye(6)  # without points nothing is held
    root = np.linalg.cholesky(pull)
    whitened = np.linalg.solve(root, np.linalg.solve(root, held).T)
    ratios, axes = np.linalg.eigh(0.5 * (whitened + whitened.T))
    return Observability(np.linalg.solve(root.T, axes), root @ axes, ratios, mixed=mixed)


def _limited(guess: Array) -> Array:
    """Return the covariance (6, 6) of a guess without its largest turns and shifts.

    Of those small corrections would be made, or large turns where nothing is known of either.
    """
    limited = np.zeros((6, 6))
    for block, most in (slice(0, 3), CORRECTED_M / LEVER_M), (slice(3, 6), CORRECTED_M):
        variances, axes = np.linalg.eigh(guess[block, block])
        limited[block, block] = (axes * np.minimum(variances, most**2)) @ axes.T
    return limited


def _information(points: Array, normals: Array, weights: Array) -> Array:
    J = np.concatenate([np.cross(points, normals), normals], axis=1)
    information: Array = (J * weights[:, None]).T @ J
    return information


def _distance_m(time_s: float) -> float:
    """Return how far off the guess may be after a time."""
    accelerating_s = min(time_s, SPEED_M_S / ACCELERATION_M_S2)
    accelerated = 0.5 * ACCELERATION_M_S2 * accelerating_s**2 + SPEED_M_S * (time_s - accelerating_s)
    return VELOCITY_SIGMA_M_S * time_s + accelerated


def _angle_rad(time_s: float, has_gyroscope: bool) -> float:
    """Return how much the guessed attitude may be off after a time."""
    if has_gyroscope:
        return GYROSCOPE_RAD_S * time_s
    accelerating_s = min(time_s, RATE_RAD_S / ANGULAR_ACCELERATION_RAD_S2)
    return 0.5 * ANGULAR_ACCELERATION_RAD_S2 * accelerating_s**2 + RATE_RAD_S * (time_s - accelerating_s)
