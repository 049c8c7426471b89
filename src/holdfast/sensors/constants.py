"""Which constants of sensors the graph estimates, what it knows of one, and what it does of one learnt before."""

from collections.abc import Mapping
from math import radians
from typing import NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from holdfast.config.model import Config
from holdfast.config.section import Section
from holdfast.messages import Array
from holdfast.sensors.clock import IF_RIGHT_S, has_estimated_clock
from holdfast.sensors.gnss import GnssModel
from holdfast.sensors.nonholonomic import NonholonomicModel
from holdfast.sensors.odometry import OdometryModel
from holdfast.sensors.odometry_calibration import arm_name
from holdfast.sensors.sensor import Parameter, Sensor
from holdfast.sensors.twist import TwistModel

ANGLE_RAD, ARM_M, SCALE = radians(0.25), 0.01, 0.005  # by which a mount gives, and rolling radii change
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
    found: dict[str, Parameter] = {}
    for name, sensor in sensors.items():
        prior = sensor.calibration.prior if isinstance(sensor, OdometryModel) else getattr(sensor, "parameter", None)
        if prior is not None:
            found[prior.name(name)] = prior
    return found


def arms_of(sensors: Mapping[str, Sensor]) -> dict[str, Parameter]:
    """Return the lever arms of odometries, which the graph estimates beside their other constants."""
    odometries = {name: one.calibration for name, one in sensors.items() if isinstance(one, OdometryModel)}
    return {arm_name(name): one.arm_prior for name, one in odometries.items() if one.arm_prior is not None}


def priors_of_machine(config: Config, sensors: Mapping[str, Sensor]) -> dict[str, Parameter]:
    """Return all that the graph estimates of the sensors and of the primary IMU."""
    return priors_of(sensors) | arms_of(sensors) | priors_of_imu(config)


def length_and_sigma(vector: Array, sigmas: Array) -> tuple[float, float]:
    """Return how long a vector (n,) is and the sigma along it, given those (n,) of its components."""
    length = float(np.linalg.norm(vector))
    return length, float(np.linalg.norm(vector / max(length, 1e-9) * sigmas))


def change_of(sensor: Sensor) -> Array | None:
    """Return by how much (p,) the constant of a sensor may be another one on the next day, as sigmas.

    None where it has none, or one of the world instead of the machine.
    """
    if isinstance(sensor, OdometryModel):
        return np.array([ANGLE_RAD, ANGLE_RAD, ANGLE_RAD, IF_RIGHT_S])
    parameter: Parameter | None = getattr(sensor, "parameter", None)
    if parameter is None:
        return None
    if has_estimated_clock(sensor):
        return np.array([*np.full(len(parameter.mean) - 1, ARM_M), IF_RIGHT_S])
    kinds = (GnssModel, ARM_M), (TwistModel, SCALE), (NonholonomicModel, ANGLE_RAD)
    found = next((change for kind, change in kinds if isinstance(sensor, kind)), None)
    return None if found is None else np.full(len(parameter.mean), found)


def priors_of_imu(config: Config) -> dict[str, Parameter]:
    """Return what the graph estimates of the primary IMU, by its name: the scale factors (3,) of its gyroscope.

    A scale factor is 1 and this, per axis of I.
    """
    ratio = config.imu.gyroscope_error_ratio
    if not config.graph.gyroscope_scale or ratio == 0.0:
        return {}
    sigmas = np.full(3, ratio)
    return {config.imu_name: Parameter(np.zeros(3), sigmas, walk=RATIO_WALK * sigmas)}


def carried(prior: Parameter, mean: Array, sigmas: Array, change: Array, *, is_off: bool) -> Parameter:
    """Return the prior of a constant that was learnt before; all arrays are (p,).

    Its mean is what was learnt, its sigma is not below that and how much it may have changed. A clock that was
    believed to be right keeps the prior of the configuration.

    Args:
        prior: what the configuration says.
        mean: what was learnt.
        sigmas: of that.
        change: what `change_of` says.
        is_off: the clock was believed to be off.
    """
    if_right = np.full(len(prior.mean), np.inf) if prior.if_right is None else prior.if_right
    is_learnt = np.isinf(if_right) | is_off
    left = np.where(is_learnt, np.inf, if_right)
    return Parameter(
        np.where(is_learnt, mean, prior.mean),
        np.where(is_learnt, np.minimum(prior.sigmas, np.hypot(sigmas, change)), prior.sigmas),
        left if np.isfinite(left).any() else None,
        prior.shared,
        prior.walk,
    )
