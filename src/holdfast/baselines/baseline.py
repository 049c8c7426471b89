"""The estimator's interface around a comparison system of any kind."""

from collections import Counter
from collections.abc import Callable
from typing import Protocol

import gtsam

from holdfast.baselines.intake import Intake
from holdfast.config.model import Config
from holdfast.events import Event, Outcome
from holdfast.geometry.earth import Geodetic
from holdfast.messages import Message
from holdfast.state import Output

IDENTITY = gtsam.Pose3()  # T_W_O of a baseline: every correction is a step of its output


class System(Protocol):
    """One comparison system."""

    @property
    def initialised(self) -> bool:
        """Whether estimates are being given."""
        ...

    @property
    def waiting_for(self) -> str:
        """What keeps it from starting."""
        ...

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival."""
        ...


class Baseline:
    """A comparison system that can be replayed and judged as the estimator is.

    Args:
        config: of the machine; the same file as the estimator's.
        make: makes the system from the configuration and the intake, through which it checks all measurements.

    Raises:
        ConfigError: the machine measures no position to start by, or lacks what the system needs.
    """

    def __init__(self, config: Config, make: Callable[[Config, Intake], System]) -> None:
        self.config = config
        self._intake = Intake(config)
        self._system = make(config, self._intake)

    @property
    def initialised(self) -> bool:
        """Whether estimates are being given."""
        return self._system.initialised

    @property
    def waiting_for(self) -> str:
        """What keeps it from starting."""
        return self._system.waiting_for

    @property
    def counts(self) -> Counter[tuple[str, Outcome]]:
        """Number of measurements by sensor and outcome."""
        return self._intake.counts

    @property
    def events(self) -> list[Event]:
        """The events since `take_events`."""
        return self._intake.events

    @property
    def datum(self) -> Geodetic | None:
        """Origin of W on the ellipsoid, or None until the first accepted fix."""
        return self._intake.world.datum

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._intake.events = self._intake.events, []
        return events

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival."""
        return self._system.process(message)
