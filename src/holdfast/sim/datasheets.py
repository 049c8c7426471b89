"""What the datasheets of all simulated sensors share: topic, rate, delays and clocks.

These are sections of a scenario. Topics and frames end up in the configuration that is written beside the recording.
Each kind of sensor has a file in `holdfast.sim.sensors`.
"""

from collections.abc import Mapping
from math import hypot

from pydantic import Field

from holdfast.config.section import Section, Topic, quantity
from holdfast.sim.readings import Generators


class Transport(Section):
    """How messages travel from the sensor to the recording."""

    latency_s: float = quantity("s", 0.0, ge=0, le=10, doc="from the measurement to its arrival, at least")
    jitter_s: float = quantity("s", 0.0, ge=0, le=10, doc="mean of the exponential delay on top")
    loss_ratio: float = quantity("1", 0.0, ge=0, lt=1, doc="fraction of messages that never arrive")
    duplicate_ratio: float = quantity("1", 0.0, ge=0, lt=1, doc="fraction of messages that arrive twice")


class Clock(Section):
    """How the sensor's stamps depart from true time, which is the clock of the recording computer."""

    offset_s: float = quantity("s", 0.0, ge=-10, le=10, doc="added to every stamp")
    drift_ppm: float = quantity("ppm", 0.0, ge=-1000, le=1000, doc="growth of the offset")
    jitter_s: float = quantity("s", 0.0, ge=0, le=1, doc="sigma of every stamp")
    calibrated: bool = Field(True, description="the configuration written beside the recording knows offset_s")


class Sheet(Section):
    """What everything has that a machine lists among its sensors."""

    kind: str
    frame: str = Field(min_length=1, description="its frame in `extrinsics`")


class SimulatedSensor(Sheet):
    """What all sensors have that send messages."""

    topic: Topic
    rate_hz: float = quantity("Hz", gt=0, le=2000, doc="messages per second")
    transport: Transport = Transport()
    clock: Clock = Clock()

    @property
    def ready_s(self) -> float:
        """The time after which a measurement is complete, and sent."""
        return 0.0

    def first_s(self, name: str, sheets: Mapping[str, Sheet], generators: Generators) -> float:  # noqa: ARG002
        """Return when it measures for the first time: at random within one period.

        Args:
            name: of the sensor.
            sheets: of all sensors, by name.
            generators: random numbers by the names of their purpose.
        """
        return float(generators(name, "phase").uniform(0.0, 1.0 / self.rate_hz))


def positive(**known: float) -> dict[str, float]:
    """Return those of the numbers that are positive: the configuration refuses zero."""
    return {name: value for name, value in known.items() if value > 0.0}


def correlation_s(white: float, slow: float, time_constant_s: float) -> float:
    """Return the correlation time of the sum of white noise and a Gauss-Markov process, both with their sigmas.

    It is the integral of the autocorrelation over both sides, 2 tau times the fraction of the slow variance.
    """
    return 2.0 * time_constant_s * (slow / hypot(white, slow)) ** 2 if slow > 0.0 else 0.0
