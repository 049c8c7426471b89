"""Sheds load by rule: of each sensor so many measurements a second are taken in, and of more the newest.

A driver that goes mad publishes thousands a second. To take them all in would hold up the IMU path, and what waits
grows old; so what is beyond the budget of its sensor is left out at once, counted, and told once a second.
"""

from dataclasses import dataclass

from holdfast.config.model import Config, check_sensor
from holdfast.config.sensors import InertialConfig, JointConfig
from holdfast.errors import ConfigError
from holdfast.estimator.density import Shedding
from holdfast.event_log import EventLog

BURST_S = 0.1  # of measurements may come at once, after the network was held up
ENCODER = 5  # times as many angles of an encoder, which only the IMU path takes


@dataclass(slots=True)
class Budget:
    """How many measurements of one sensor may still be taken in.

    Attributes:
        room: fills up with the time of arrival.
        arrival_ns: at which it was filled last.
    """

    rate_hz: float
    room: float
    arrival_ns: int | None = None

    def fill(self, arrival_ns: int) -> int:
        """Return how many may be taken in at an arrival."""
        most = max(1.0, BURST_S * self.rate_hz)
        since_ns = 0 if self.arrival_ns is None else arrival_ns - self.arrival_ns
        self.arrival_ns = arrival_ns  # also where the clock went back
        self.room = min(most, self.room + max(since_ns, 0) * 1e-9 * self.rate_hz)
        return int(self.room)


class Overload:
    """The budgets of all sensors but IMUs, of which nothing may be left out.

    Args:
        config: names the sensors, and `realtime.max_rate_hz`.
        log: where to count and to report.
    """

    def __init__(self, config: Config, log: EventLog) -> None:
        self._config = config
        rate_hz = config.realtime.max_rate_hz
        rates = {
            name: rate_hz * (ENCODER if isinstance(sensor, JointConfig) else 1)
            for name, sensor in config.sensors.items()
            if not isinstance(sensor, InertialConfig)
        }
        self._budgets = {name: Budget(rate, max(1.0, BURST_S * rate)) for name, rate in rates.items()}
        self._shedding = {name: Shedding(name, rate, log) for name, rate in rates.items()}

    def room(self, sensor: str, arrival_ns: int) -> int | None:
        """Return how many measurements of a sensor may be taken in now; None if there is no limit."""
        budget = self._budgets.get(sensor)
        return None if budget is None else budget.fill(arrival_ns)

    def check(self, sensor: object) -> None:
        """Refuse a sensor of which nothing is left out.

        Raises:
            ConfigError: names those of which something may be.
        """
        check_sensor(self._config, sensor)
        if sensor not in self._budgets:
            allowed = ", ".join(self._budgets) or "none is configured"
            raise ConfigError(f"sensor: nothing of the IMU {sensor!r} may be left out (allowed: {allowed})")

    def admits(self, sensor: str, arrival_ns: int, stamp_ns: int) -> bool:
        """Return whether one more may be taken in, and count it as left out if not.

        Args:
            sensor: its name.
            arrival_ns: when it came.
            stamp_ns: for the event.
        """
        budget = self._budgets.get(sensor)
        if budget is None:
            return True
        if budget.fill(arrival_ns) < 1:
            self.shed(sensor, 1, arrival_ns, stamp_ns)
            return False
        budget.room -= 1.0
        return True

    def shed(self, sensor: str, number: int, arrival_ns: int, stamp_ns: int) -> None:
        """Count measurements that are left out, and report it, once a second at most; see `admits`."""
        self._shedding[sensor].add(number, arrival_ns, stamp_ns)
