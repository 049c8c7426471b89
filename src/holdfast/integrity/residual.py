"""By how much a measurement is beyond an estimate, whatever that is worth."""

from typing import Any

from holdfast.events import Outcome
from holdfast.graph.sensor_parameters import with_beliefs
from holdfast.graph.smoother import Smoother
from holdfast.sensors.sensor import Innovation, Joint, PositionSensor, StateSensor


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
    state = with_beliefs(smoother, sensor, smoother.mean_at(measurement.stamp_ns, joint))
    return sensor.innovation(measurement, state)
