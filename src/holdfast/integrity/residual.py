"""By how much a measurement is beyond an estimate, whatever that is worth."""

from typing import Any

import numpy as np

from holdfast.graph.smoother import Smoother
from holdfast.sensors.sensor import Innovation, Joint, PositionSensor, StateSensor
from holdfast.state import Outcome


def residual(
    sensor: StateSensor | PositionSensor, measurement: Any, smoother: Smoother, joint: Joint | None = None
) -> Innovation | Outcome:
    """Compare a measurement that has a node with a smoother's estimate; a slow error of the sensor is left in.

    Args:
        sensor: that measured.
        measurement: it.
        smoother: whose estimate it is compared with.
        joint: the turn joint at its time.
    """
    stamp_ns, parameter = measurement.stamp_ns, sensor.parameter
    state = smoother.mean_at(stamp_ns, joint)
    if parameter is not None:
        known = smoother.parameter_estimate(parameter.name(measurement.sensor))
        value, sigmas = (parameter.mean, parameter.sigmas) if known is None else known
        state = state._replace(parameter=value, parameter_covariance=np.diag(sigmas**2))
    return sensor.innovation(measurement, state)
