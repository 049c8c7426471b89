"""Noise models: a covariance and a robust loss become what GTSAM weighs a residual with."""

from collections.abc import Callable

import gtsam

from holdfast.config.model import RobustLoss
from holdfast.messages import Array


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
