"""Which constants of sensors the graph estimates, what it knows of one, and what it does of one learnt before."""

from collections.abc import Mapping
from typing import NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from holdfast.config.model import Config
from holdfast.config.section import Section
from holdfast.messages import Array
from holdfast.sensors.sensor import Parameter, Sensor

RATIO = 1e-3  # by which the scale factors of a gyroscope change with the temperature of a day
RATIO_WALK = 0.003  # of the prior of a gyroscope's scale factors in a second, per sqrt(s), as its temperature changes
OBSERVED = 0.5  # of the sigma of a prior: what is known no better has not been learnt
ANOTHER = 1e-3  # probability that a sensor is an entirely other one after a restart


class LearntConstant(Section):
    """What is learnt of a constant (p,) of a sensor, such as its mounting and its clock."""

    mean: tuple[float, ...] = Field(min_length=1, description="as estimated")
    sigmas: tuple[float, ...] = Field(min_length=1, description="of each")
    is_off: bool = Field(False, description="its clock or lever arm is believed to be otherwise than configured")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.sigmas) != len(self.mean) or min(self.sigmas) <= 0.0:
            raise ValueError("sigmas: must be positive, one for each number of mean")
        return self


class Constant(NamedTuple):
    """What is known of a constant (p,) of a sensor, such as its mounting and its clock.

    Attributes:
        value: as it is believed: a clock that may be right is held where it was configured.
        sigmas: (p,) of that.
        measured: (p,) if nothing were held.
        covariance: (p, p) of that.
        prior: what the configuration says.
        is_off: it is believed to be otherwise than configured.
    """

    value: Array
    sigmas: Array
    measured: Array
    covariance: Array
    prior: Parameter
    is_off: bool


def priors_of(sensors: Mapping[str, Sensor]) -> dict[str, Parameter]:
    """Return what the graph estimates of some sensors, by the name under which it knows it."""
    return {one.name(name): one for name, sensor in sensors.items() for one in sensor.parameters}


def priors_of_machine(config: Config, sensors: Mapping[str, Sensor]) -> dict[str, Parameter]:
    """Return all that the graph estimates of the sensors and of the primary IMU."""
    return priors_of(sensors) | priors_of_imu(config)


def length_and_sigma(vector: Array, sigmas: Array) -> tuple[float, float]:
    """Return how long a vector (n,) is and the sigma along it, given those (n,) of its components."""
    length = float(np.linalg.norm(vector))
    return length, float(np.linalg.norm(vector / max(length, 1e-9) * sigmas))


def priors_of_imu(config: Config) -> dict[str, Parameter]:
    """Return what the graph estimates of the primary IMU, by its name: the scale factors (3,) of its gyroscope.

    A scale factor is 1 and this, per axis of I.
    """
    ratio = config.imu.gyroscope_error_ratio
    if not config.graph.gyroscope_scale or ratio == 0.0:
        return {}
    sigmas = np.full(3, ratio)
    return {config.imu_name: Parameter(np.zeros(3), sigmas, walk=RATIO_WALK * sigmas, change=np.full(3, RATIO))}


def carried(prior: Parameter, learnt: LearntConstant) -> Parameter:
    """Return the prior of a constant that was learnt before.

    Its mean is what was learnt, its sigma is not below that and how much it may have changed. What was believed to be
    as configured keeps the prior of the configuration.

    Args:
        prior: what the configuration says, of a constant that may have changed since.
        learnt: before.
    """
    assert prior.change is not None
    mean, sigmas, is_off = np.array(learnt.mean), np.array(learnt.sigmas), learnt.is_off
    if_right = np.full(len(prior.mean), np.inf) if prior.if_right is None else prior.if_right
    is_learnt = np.isinf(if_right) | is_off
    left = np.where(is_learnt, np.inf, if_right)
    return prior._replace(
        mean=np.where(is_learnt, mean, prior.mean),
        sigmas=np.where(is_learnt, np.minimum(prior.sigmas, np.hypot(sigmas, prior.change)), prior.sigmas),
        if_right=left if np.isfinite(left).any() else None,
    )
