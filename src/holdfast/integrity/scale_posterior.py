"""How many times larger a standard deviation is than configured: its posterior, on a grid of its logarithm: (67)."""

from math import log

import numpy as np

from holdfast.integrity.learnt_snapshot import LearntScale, probabilities, unless_another
from holdfast.messages import Array

LOWEST, HIGHEST, POINTS = 0.05, 10.0, 160
PRIOR_SIGMA = log(3.0)
MAX_RATIO = 9.0  # of a squared residual and its expectation: an outlier tells no more

_LOG_SCALES: Array = np.linspace(log(LOWEST), log(HIGHEST), POINTS)
_SQUARED_SCALES: Array = np.exp(2.0 * _LOG_SCALES)
# what is configured is the prior's mean and one sigma, as what is told is the posterior's
_LOG_PRIOR: Array = -0.5 * ((_LOG_SCALES + PRIOR_SIGMA) / PRIOR_SIGMA) ** 2


class ScalePosterior:
    """What squared residuals say of the scale k, where each has the expectation n (k^2 a + b).

    Args:
        carried: what was learnt before, which is forgotten as what is taken in.
        unit: of the scale, in units of what was learnt before.
    """

    def __init__(self, carried: LearntScale | None = None, unit: float = 1.0) -> None:
        self._log_likelihood: Array = np.zeros(POINTS)
        self._value: float | None = None
        self._has_learnt = carried is not None
        if carried is not None:
            mean = min(max(carried.log_mean - log(unit), _LOG_SCALES[0]), _LOG_SCALES[-1])
            known = -0.5 * (_LOG_SCALES - mean) ** 2 / carried.log_sigma**2
            self._log_likelihood = unless_another(known, _LOG_PRIOR) - _LOG_PRIOR

    @property
    def value(self) -> float:
        """The scale that is not exceeded with 84 %: the posterior's mean and one sigma, of the logarithm."""
        if self._value is None:
            mean, variance = self._moments()
            self._value = float(min(HIGHEST, np.exp(mean + np.sqrt(variance))))
        return self._value

    def learnt(self, unit: float = 1.0) -> LearntScale | None:
        """Return what is believed of the scale, whose unit is given; None where nothing was taken in."""
        if not self._has_learnt:
            return None
        mean, variance = self._moments()
        return LearntScale.of(mean + log(unit), float(np.sqrt(variance)))

    def _moments(self) -> tuple[float, float]:
        """Return mean and variance of the logarithm."""
        weights = probabilities(_LOG_PRIOR + self._log_likelihood)
        mean = float(weights @ _LOG_SCALES)
        return mean, float(weights @ (_LOG_SCALES - mean) ** 2)

    def learn(self, squared: float, size: int, scaled: float, other: float, weight: float) -> None:
        """Take in one residual.

        Args:
            squared: its squared norm.
            size: the number n of its components.
            scaled: the variance a of each that the scale is of, at scale 1.
            other: the variance b of each that has nothing to do with the scale.
            weight: below 1 where residuals have errors in common.
        """
        if scaled <= 0.0:
            return
        self._has_learnt = True
        squared = min(squared, MAX_RATIO * size * (self.value**2 * scaled + other))
        variances = _SQUARED_SCALES * scaled + other
        self._log_likelihood -= 0.5 * weight * (size * np.log(variances) + squared / variances)
        self._value = None

    def forget(self, fraction: float) -> None:
        """Forget a fraction of what was taken in."""
        self._log_likelihood *= 1.0 - fraction
        self._value = None
