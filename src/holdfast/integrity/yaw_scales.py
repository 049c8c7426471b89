"""How wrong gyroscope, odometry and headings turn about the vertical, each so many times what is configured.

The three err independently, so their differences tell them apart (a three-cornered hat); two alone tell only the sum.
"""

from math import log, sqrt
from typing import NamedTuple

import numpy as np

from holdfast.integrity.learnt_snapshot import LearntYaw, probabilities, unless_another
from holdfast.messages import Array

LOWEST, HIGHEST, POINTS = 0.05, 20.0, 19
PRIOR_SIGMA = log(3.0)
MAX_RATIO = 9.0  # of a squared residual and its expectation: an outlier tells no more

_LOG_SCALES: Array = np.linspace(log(LOWEST), log(HIGHEST), POINTS)
_SQUARED_SCALES: Array = np.exp(2.0 * _LOG_SCALES)
# its root mean square is what is configured
_LOG_PRIOR: Array = -0.5 * ((_LOG_SCALES + PRIOR_SIGMA**2) / PRIOR_SIGMA) ** 2
_JOINT_PRIOR: Array = _LOG_PRIOR[:, None, None] + _LOG_PRIOR[:, None] + _LOG_PRIOR
_GRID: Array = np.stack(np.meshgrid(_LOG_SCALES, _LOG_SCALES, _LOG_SCALES, indexing="ij"), axis=-1)


class Turned(NamedTuple):
    """Variances of the angle by which one of the three says that the machine has turned [rad^2].

    Attributes:
        scaled: at scale 1.
        other: what has nothing to do with the scale.
    """

    scaled: float
    other: float

    def at(self, squared_scale: float) -> float:
        """Return the variance at one scale."""
        return squared_scale * self.scaled + self.other

    def along(self, axis: int) -> Array:
        """Return the variances at all scales, along one axis of the grid."""
        shape = [1, 1, 1]
        shape[axis] = POINTS
        return (_SQUARED_SCALES * self.scaled + self.other).reshape(shape)


class YawScales:
    """The posterior of three scales on a grid of their logarithms: gyroscope, odometry, headings; (72), (73).

    Args:
        carried: what was learnt before, which is forgotten as what is taken in.
        unit: of the scale of the odometry, in units of what was learnt before.
    """

    def __init__(self, carried: LearntYaw | None = None, unit: float = 1.0) -> None:
        self._log_likelihood: Array = np.zeros((POINTS, POINTS, POINTS))
        self._values: tuple[float, float, float] | None = None
        self._has_learnt = carried is not None
        if carried is not None:
            means = np.array(carried.log_means) - [0.0, log(unit), 0.0]
            off = _GRID - np.clip(means, _LOG_SCALES[0], _LOG_SCALES[-1])
            information = np.linalg.inv(np.array(carried.log_covariance))
            known = -0.5 * np.einsum("...i,ij,...j", off, information, off)
            self._log_likelihood = unless_another(known, _JOINT_PRIOR) - _JOINT_PRIOR

    @property
    def values(self) -> tuple[float, float, float]:
        """The scales: the root of the mean of the square of each, which weighs the three best against each other."""
        if self._values is None:
            weights = probabilities(self._log_likelihood + _JOINT_PRIOR)
            self._values = (
                _root_mean_square(weights.sum(axis=(1, 2))),
                _root_mean_square(weights.sum(axis=(0, 2))),
                _root_mean_square(weights.sum(axis=(0, 1))),
            )
        return self._values

    def learnt(self, unit: float = 1.0) -> LearntYaw | None:
        """Return what is believed of the three, of which that of the odometry has a unit; None for nothing."""
        if not self._has_learnt:
            return None
        weights = probabilities(self._log_likelihood + _JOINT_PRIOR)
        mean = np.einsum("abc,abci->i", weights, _GRID)
        off = _GRID - mean
        covariance = np.einsum("abc,abci,abcj->ij", weights, off, off)
        return LearntYaw.of(mean + np.array([0.0, log(unit), 0.0]), covariance)

    def learn_from_two(self, apart_rad: float, gyroscope: Turned, odometry: Turned, weight: float) -> None:
        """Take in what the odometry has turned beyond the gyroscope; `weight` as in `learn_from_three`."""
        k_g, k_o, _ = self.values
        most = MAX_RATIO * (gyroscope.at(k_g**2) + odometry.at(k_o**2))
        variances = gyroscope.along(0) + odometry.along(1)
        self._take(np.log(variances) + min(apart_rad**2, most) / variances, weight)

    def learn_from_three(
        self, beyond_rad: tuple[float, float], gyroscope: Turned, odometry: Turned, headings: Turned, weight: float
    ) -> None:
        """Take in what headings have turned beyond gyroscope and odometry.

        `weight` is below 1 where residuals have errors in common.
        """
        expected = [one.at(k**2) for one, k in zip((gyroscope, odometry, headings), self.values, strict=True)]
        shrunk = min(1.0, 2.0 * MAX_RATIO / max(float(_squared(beyond_rad, *expected)), 1e-9))
        g, o, h = gyroscope.along(0), odometry.along(1), headings.along(2)
        self._take(np.log(g * o + h * (g + o)) + shrunk * _squared(beyond_rad, g, o, h), weight)

    def _take(self, doubled: Array, weight: float) -> None:
        """Take in minus twice a logarithm of the likelihood."""
        self._has_learnt = True
        self._log_likelihood -= 0.5 * weight * doubled
        self._log_likelihood -= (self._log_likelihood + _JOINT_PRIOR).max()
        self._values = None

    def forget(self, fraction: float) -> None:
        """Forget a fraction of what was taken in."""
        self._log_likelihood *= 1.0 - fraction
        self._values = None


def _squared(residuals: tuple[float, float], g: Array | float, o: Array | float, h: Array | float) -> Array:
    """Return the squared Mahalanobis length of both residuals, which have the error of the headings in common."""
    by_g, by_o = residuals
    squared: Array = np.asarray(by_g**2 * (h + o) - 2.0 * by_g * by_o * h + by_o**2 * (h + g))
    return squared / (g * o + h * (g + o))


def _root_mean_square(weights: Array) -> float:
    return sqrt(float(weights @ _SQUARED_SCALES))
