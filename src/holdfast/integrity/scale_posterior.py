"""How many times larger a standard deviation is than configured: its posterior, on a grid of its logarithm: (67)."""

from math import log

import numpy as np

from holdfast.messages import Array

LOWEST, HIGHEST, POINTS = 0.05, 10.0, 160
PRIOR_SIGMA = log(3.0)
MAX_RATIO = 9.0  # of a squared residual and its expectation: an outlier tells no more

_LOG_SCALES: Array = np.linspace(log(LOWEST), log(HIGHEST), POINTS)
_SQUARED_SCALES: Array = np.exp(2.0 * _LOG_SCALES)
# what is configured is the prior's mean and one sigma, as what is told is the posterior's
_LOG_PRIOR: Array = -0.5 * ((_LOG_SCALES + PRIOR_SIGMA) / PRIOR_SIGMA) ** 2


class ScalePosterior:
    """What squared residuals say of the scale k, where each has the expectation n (k^2 a + b)."""

    def __init__(self) -> None:
        self._log_likelihood: Array = np.zeros(POINTS)
        self._value: float | None = None

    @property
    def value(self) -> float:
        """The scale that is not exceeded with 84 %: the posterior's mean and one sigma, of the logarithm."""
        if self._value is None:
            log_posterior = _LOG_PRIOR + self._log_likelihood
            weights = np.exp(log_posterior - log_posterior.max())
            weights /= weights.sum()
            mean = float(weights @ _LOG_SCALES)
            self._value = float(min(HIGHEST, np.exp(mean + np.sqrt(weights @ (_LOG_SCALES - mean) ** 2))))
        return self._value

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
        squared = min(squared, MAX_RATIO * size * (self.value**2 * scaled + other))
        variances = _SQUARED_SCALES * scaled + other
        self._log_likelihood -= 0.5 * weight * (size * np.log(variances) + squared / variances)
        self._value = None

    def forget(self, fraction: float) -> None:
        """Forget a fraction of what was taken in."""
        self._log_likelihood *= 1.0 - fraction
        self._value = None
