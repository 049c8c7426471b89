"""What all baselines share: messages checked and counted alike, the same start, and what is shown of it."""

from collections import Counter

import gtsam

from holdfast.baselines.intake import Intake
from holdfast.baselines.start import StandstillStart
from holdfast.config.model import Config
from holdfast.geometry.earth import Geodetic
from holdfast.messages import Heading
from holdfast.sensors.imu import ImuBuffer
from holdfast.state import Event, Outcome

NO_OFFSET = gtsam.Pose3()  # T_W_O of a baseline: what corrects it is seen by who follows it


class Baseline:
    """A machine before the start; what a system does from then on, it adds in `process`.

    Args:
        config: of the machine; the same file as the estimator's.

    Raises:
        ConfigError: the machine has no GNSS to start by.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self._intake = Intake(config)
        self._buffer = ImuBuffer(config.sensors.imu)
        self._starter = StandstillStart(config, self._intake, self._buffer)

    @property
    def counts(self) -> Counter[tuple[str, Outcome]]:
        """What became of the measurements, by sensor and outcome."""
        return self._intake.counts

    @property
    def events(self) -> list[Event]:
        """What happened since `take_events`."""
        return self._intake.events

    @property
    def datum(self) -> Geodetic | None:
        """Origin of W on the ellipsoid, or None until the first accepted fix."""
        return None if self._intake.world is None else self._intake.world.datum

    @property
    def waiting_for(self) -> str:
        """What keeps it from starting."""
        return self._starter.reason

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._intake.events = self._intake.events, []
        return events

    def _start_by(self, message: Heading) -> None:
        """Keep a heading for the start, which alone needs one."""
        heading = self._intake.axis_yaw(message)
        if heading is not None:
            self.counts[message.sensor, Outcome.BEFORE_START] += 1
            self._starter.add_heading(heading)
