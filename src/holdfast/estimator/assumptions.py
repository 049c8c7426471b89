"""What is assumed of the fixes of receivers that do not say it."""

from collections.abc import Mapping

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.messages import GnssFix, Message
from holdfast.sensors.gnss import GnssModel
from holdfast.sensors.sensor import Sensor


class Assumptions:
    """Tells each assumption once."""

    def __init__(self, sensors: Mapping[str, Sensor], log: EventLog) -> None:
        self._sensors, self._log = sensors, log
        self._told: set[tuple[str, str]] = set()

    def tell(self, message: Message) -> None:
        """Report what is assumed of a message, if anything is and nobody was told."""
        sensor = self._sensors[message.sensor]
        if isinstance(sensor, GnssModel) and isinstance(message, GnssFix):
            assumed = sensor.assumption(message)
            if assumed and (message.sensor, assumed) not in self._told:
                self._told.add((message.sensor, assumed))
                self._log.report(EventKind.COVARIANCE_ASSUMED, message.stamp_ns, message.sensor, assumed)
