"""Which constants of sensors the graph estimates, and what it knows of one."""

from collections.abc import Mapping
from typing import NamedTuple

from holdfast.messages import Array
from holdfast.sensors.odometry import OdometryModel
from holdfast.sensors.sensor import Parameter, Sensor


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
