"""What a batch smoother is told: all that the estimator has checked, in continuous time.

The estimator is causal and forgets. What is to be estimated once more, with the past and the future of each
measurement, is collected by whoever listens; nothing that a listener does reaches back.
"""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from holdfast.estimator.imu_path import Received
from holdfast.estimator.learnt_view import LearntView
from holdfast.estimator.tracking import Update
from holdfast.sensors.sensor import Joint, Measurement, Parameter, Sensor
from holdfast.state import OptimisedState


@runtime_checkable
class Listener(Protocol):
    """Who is told. Times are those of the estimator's clock, which never steps: `Estimator.stamp` maps them back."""

    def receive(self, received: Received) -> None:
        """Take note of a usable sample of the IMU."""

    def add(self, measurement: Measurement, joint: Joint | None) -> None:
        """Take note of a checked measurement, in the order of arrival; `joint` is the turn joint at its time."""

    def start(
        self, state: OptimisedState, sensors: Mapping[str, Sensor], gravity: float, found: Mapping[str, Parameter]
    ) -> None:
        """Take note of a first state, or one to begin anew from, with the models from now on and gravity [m/s^2].

        `found` are constants of sensors with which the state was found, if they are far from what is configured.
        """

    def stop(self) -> None:
        """Take note that nothing of before is known any more, until the next start."""

    def update(self, update: Update, learnt: LearntView) -> None:
        """Take note of an optimisation, and of what is known of the sensors after it."""
