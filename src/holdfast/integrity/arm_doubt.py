"""How far a lever arm that may be far off puts positions beside what an estimate expects, while nobody knows better.

An estimate that positions lead has their arm's error e in it, as its attitude R_W_I was then. Once the machine has
turned, the next position is (R - R_then) e beside it: no fault of the receiver. (88) in docs/math.md.
"""

import gtsam

from holdfast.graph.smoother import Smoother
from holdfast.messages import Array
from holdfast.sensors.lever_arm import arm_of
from holdfast.sensors.sensor import PositionSensor

KNOWN_M = 0.1  # an arm that is known so well is not forgotten


class ArmDoubt:
    """The doubt in the lever arm of one receiver, which is held as it was measured until it proves to be wrong.

    Args:
        sensor: its model.
    """

    def __init__(self, sensor: PositionSensor) -> None:
        self._name, arm = sensor.name, arm_of(sensor.parameters)
        self._arm = None if arm is None or arm.if_right is None else arm
        self._then: Array | None = None

    def note_used(self, attitude: gtsam.Rot3) -> None:
        """Note the attitude at which a position has just entered the graph."""
        self._then = attitude.matrix()

    def of_prediction(self, smoother: Smoother, attitude: gtsam.Rot3) -> Array | None:
        """Return the covariance (3, 3) [m^2] that the arm adds to a prediction in W; None where there is no doubt."""
        if self._arm is None or self._then is None:
            return None
        turned = attitude.matrix() - self._then
        covariance: Array = turned @ smoother.unheld_covariance(self._arm.name(self._name), self._arm) @ turned.T
        return covariance

    def forget(self, smoother: Smoother) -> None:
        """Forget what positions told of an arm that is not known yet, as they were at odds with the estimate."""
        if self._arm is None:
            return
        name = self._arm.name(self._name)
        if smoother.unheld_covariance(name, self._arm).diagonal().max() > KNOWN_M**2:
            smoother.begin_parameter_anew(name, self._arm)
