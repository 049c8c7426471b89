"""What a batch smoother is told: all that the estimator has checked, in continuous time.

The estimator is causal and forgets. What is to be estimated once more, with the past and the future of each
measurement, is collected by whoever listens; nothing that a listener does reaches back.
"""

from collections.abc import Callable, Mapping
from typing import Protocol

from holdfast.estimator.imu_path import Received
from holdfast.estimator.tracking import Update
from holdfast.sensors.constants import Constant
from holdfast.sensors.sensor import Joint, Measurement, Sensor
from holdfast.state import OptimisedState

Used = Callable[[int, int], list[Measurement]]
"""Returns the measurements later than one time [ns] and not later than another whose factors the graph holds."""

Constants = Callable[[], Mapping[str, Constant]]
"""Returns what the graph knows of the constants of sensors."""


class Listener(Protocol):
    """Who is told. Times are those of the estimator's clock, which never steps: `Estimator.stamp` maps them back."""

    def receive(self, received: Received) -> None:
        """Take note of a usable sample of the IMU."""

    def add(self, measurement: Measurement, joint: Joint | None) -> None:
        """Take note of a checked measurement, in the order of arrival; `joint` is the turn joint at its time."""

    def start(self, state: OptimisedState, sensors: Mapping[str, Sensor], gravity: float) -> None:
        """Take note of a first state, or one to begin anew from, with the models from now on and gravity [m/s^2]."""

    def stop(self) -> None:
        """Take note that nothing of before is known any more, until the next start."""

    def update(self, update: Update, noise: Callable[[str], float], used: Used, constants: Constants) -> None:
        """Take note of an optimisation.

        `noise` tells how many times noisier than claimed a sensor is, `used` which measurements are in the graph,
        `constants` what it knows of mountings and clocks.
        """
