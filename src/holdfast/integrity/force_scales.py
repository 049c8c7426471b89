"""How wrong the accelerometer is in motion, so many times what is configured, whatever the fixes are worth.

The white variance of the fixes is unknown as well, so both are on a grid of their logarithms: short spans tell the
fixes, long ones the accelerometer.
"""

from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np

from holdfast.integrity.learnt_snapshot import LearntScale, probabilities, unless_another
from holdfast.messages import Array

LOWEST, HIGHEST, POINTS = 0.03, 30.0, 31  # of the accelerometer, a sigma
LEAST, MOST, WHITES = 3e-3, 6.0, 24  # of the fixes, a variance
ACCELEROMETER_SIGMA, WHITE_SIGMA = log(3.0), log(3.0)
REFUTED = 2.0  # by which a likelihood is smaller: two sigmas
MAX_RATIO = 9.0  # of a squared residual and its expectation: an outlier tells no more

_LOG_SCALES: Array = np.linspace(log(LOWEST), log(HIGHEST), POINTS)
_LOG_WHITES: Array = np.linspace(log(LEAST), log(MOST), WHITES)
_SQUARED: Array = np.exp(2.0 * _LOG_SCALES)[:, None, None]
_WHITES: Array = np.exp(_LOG_WHITES)[:, None]
# what is configured is the prior's mean and one sigma, as what is told is the posterior's
_OF_SCALES: Array = -0.5 * ((_LOG_SCALES + ACCELEROMETER_SIGMA) / ACCELEROMETER_SIGMA) ** 2
_LOG_PRIOR: Array = _OF_SCALES[:, None] - 0.5 * (_LOG_WHITES / WHITE_SIGMA) ** 2


class Seen(NamedTuple):
    """A residual of three axes, all (3,) [m^2], and of what its variance is made.

    Attributes:
        squared: the residual.
        known: what has nothing to do with the scales.
        error: of the accelerometer, at scale 1; the same on all axes.
        white: of the fixes, at scale 1.
        slow: of the fixes; less if their white part shows that they claim too much.
    """

    squared: Array
    known: Array
    error: float
    white: Array
    slow: Array

    def variances(self, squared_scale: Array | float, white: Array | float) -> Array:
        """Return the expectation of the squares (..., 3)."""
        fixes = white * self.white + np.minimum(white, 1.0) * self.slow
        variances: Array = self.known + squared_scale * self.error + fixes
        return variances


class _Moments(NamedTuple):
    """Mean and sigma of a logarithm."""

    mean: float
    sigma: float

    @classmethod
    def of(cls, log_values: Array, weights: Array) -> "_Moments":
        mean = float(weights @ log_values)
        return cls(mean, sqrt(float(weights @ (log_values - mean) ** 2)))


class ForceScales:
    """The posterior of both scales.

    Args:
        carried: what was learnt of the accelerometer before, which is forgotten as what is taken in.
    """

    def __init__(self, carried: LearntScale | None = None) -> None:
        self._log_likelihood: Array = np.zeros((POINTS, WHITES))
        self._moments: tuple[_Moments, _Moments] | None = None
        self._has_learnt = carried is not None
        if carried is not None:
            known = -0.5 * ((_LOG_SCALES - carried.log_mean) / carried.log_sigma) ** 2
            self._log_likelihood += (unless_another(known, _OF_SCALES) - _OF_SCALES)[:, None]

    def _marginals(self) -> tuple[_Moments, _Moments]:
        if self._moments is None:
            weights = probabilities(self._log_likelihood + _LOG_PRIOR)
            self._moments = _Moments.of(_LOG_SCALES, weights.sum(axis=1)), _Moments.of(_LOG_WHITES, weights.sum(axis=0))
        return self._moments

    @property
    def accelerometer(self) -> float:
        """The scale of its error that is not exceeded with 84 %."""
        found = self._marginals()[0]
        return exp(found.mean + found.sigma)

    @property
    def most(self) -> float:
        """The largest scale of its error that is not refuted."""
        likelihood = (self._log_likelihood - 0.5 * (_LOG_WHITES / WHITE_SIGMA) ** 2).max(axis=1)
        return exp(_LOG_SCALES[likelihood >= likelihood.max() - REFUTED][-1])

    def learnt(self) -> LearntScale | None:
        """Return what is believed of the accelerometer; None where nothing was taken in."""
        found = self._marginals()[0]
        return LearntScale.of(found.mean, found.sigma) if self._has_learnt else None

    def learn(self, seen: Seen, weight: float) -> None:
        """Take in a residual; `weight` is below 1 where residuals have errors in common."""
        if seen.error <= 0.0:
            return
        self._has_learnt = True
        accelerometer, white = self._marginals()
        expected = seen.variances(exp(2.0 * accelerometer.mean), exp(white.mean))
        squared = np.minimum(seen.squared, MAX_RATIO * expected)
        variances = seen.variances(_SQUARED, _WHITES)
        self._log_likelihood -= 0.5 * weight * (np.log(variances) + squared / variances).sum(axis=-1)
        self._moments = None

    def forget(self, fraction: float) -> None:
        """Forget a fraction of what was taken in."""
        self._log_likelihood *= 1.0 - fraction
        self._moments = None
