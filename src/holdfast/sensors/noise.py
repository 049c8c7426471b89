"""Noise models: a covariance and a robust loss become what GTSAM weighs a residual with."""

from collections.abc import Callable, Sequence
from math import inf
from typing import NamedTuple

import gtsam

from holdfast.config.sensors import RobustLoss
from holdfast.messages import Array

UNBOUNDED = RobustLoss()  # the square, whatever the residual
FREE_VARIANCE = 1e12  # of what a factor says nothing about
FREE_TILT_RAD = 1e2  # the same of roll and pitch: much more, and a rotated covariance could not be inverted

LEAST_WHITE, MOST_WHITE = 0.05, 0.9  # of a claim, as far as measurements tell


class Colour(NamedTuple):
    """How the error of a measurement is composed, in units of the covariance that it claims.

    Attributes:
        white: variance of the part that is independent from one measurement to the next.
        slow: variance of the part that lasts.
        time_constant_s: after which the slow part is another one.
        distance_constant_m: over which it is another one, too: multipath is a pattern in space.
        white_correlation_s: correlation time of the white part, which no sensor's is quite.
    """

    white: float
    slow: float
    time_constant_s: float
    distance_constant_m: float = inf
    white_correlation_s: float = 0.0

    def with_white(self, white: float) -> "Colour":
        """Return the same claim split otherwise, as successive measurements tell."""
        white = min(max(white, LEAST_WHITE), MOST_WHITE)
        return self._replace(white=white, slow=1.0 - white)


WHITE = Colour(1.0, 0.0, 1.0)


def noise_model(covariance: Array, loss: RobustLoss) -> gtsam.noiseModel.Base:
    """Return the noise model of a residual with covariance (n, n), under the sensor's robust loss."""
    gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
    if loss.kind == "none":
        return gaussian
    estimators: dict[str, Callable[[float], gtsam.noiseModel.mEstimator.Base]] = {
        "huber": gtsam.noiseModel.mEstimator.Huber.Create,
        "tukey": gtsam.noiseModel.mEstimator.Tukey.Create,
        "cauchy": gtsam.noiseModel.mEstimator.Cauchy.Create,
    }
    return gtsam.noiseModel.Robust.Create(estimators[loss.kind](loss.threshold), gaussian)


def correlation_inflation(correlation_s: float, since_last_s: float) -> float:
    """Return the factor on the variance of one of many measurements with correlated errors.

    n measurements an interval dt apart, with errors of correlation time tau, say as much as n / (1 + 2 tau / dt)
    independent ones: (31) in docs/math.md.
    """
    return 1.0 + 2.0 * correlation_s / max(since_last_s, 1e-3)


def shared_inflation(correlation_s: float, since_last_s: Sequence[float]) -> float:
    """Return the factor on the variance of each of some measurements that enter at once.

    They say as much together as by `correlation_inflation` one after the other, but each says the same: a first one
    after a long silence would else outweigh its successors, and bring all of its white noise.
    """
    return len(since_last_s) / sum(1.0 / correlation_inflation(correlation_s, since_s) for since_s in since_last_s)
