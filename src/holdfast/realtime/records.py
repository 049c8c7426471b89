"""How samples, measurements and optimised states lie in the shared memory: fixed lengths, every bit of a float kept.

A message packs itself into a row of numbers. How long the rows are, and which sensors there are, follows from the
configuration, which both processes have.
"""

from dataclasses import dataclass
from struct import Struct
from typing import Literal, Self

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.estimator.health import HealthMonitor
from holdfast.geometry.earth import Geodetic
from holdfast.kernel.follower import HAS_DATUM, HAS_STATE, IS_FORTRAN, IS_LOST
from holdfast.messages import Array, ImuSample, Message
from holdfast.sensors.registry import inputs_of
from holdfast.state import OptimisedState

MESSAGE, RESET, DATUM = range(3)  # kinds of requests
COUNTERS = 5  # of what is published: epoch, life, updates, recoveries, lost sensors
STATE_VALUES, COVARIANCE_VALUES = 24, 225

SAMPLE = Struct("<qqq6d")  # epoch, stamp, arrival, specific force, angular velocity: `holdfast.kernel.ring`

UNPACKED = "nav", "bias", "covariance", "angular_velocity"

Request = Message | Geodetic | None
"""What the optimiser may be asked to take in: a message, a datum to begin anew at, or None for a reset."""


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """What the optimiser publishes after each optimisation.

    Attributes:
        epoch: how often the IMU path had begun anew; a record of an earlier epoch is void.
        life: how often a first state was found.
        updates: how many optimisations there were.
        recoveries: how often GNSS was regained.
        is_lost: no receiver of positions is trusted.
        lost: the sensors that are not trusted.
        health: what `HealthMonitor.snapshot` says.
        gravity: in m/s^2.
        datum: of W, None until there is one.
        state: the newest node, None before the start.
    """

    epoch: int
    life: int
    updates: int
    recoveries: int
    is_lost: bool
    lost: tuple[str, ...]
    health: tuple[int, ...]
    gravity: float
    datum: Geodetic | None
    state: OptimisedState | None


class PackedState(OptimisedState):
    """An optimised state that is unpacked when more of it is asked for than its stamp."""

    __slots__ = ("_packed",)
    _packed: "tuple[bytes, Records]"

    @classmethod
    def of(cls, stamp_ns: int, packed: bytes, records: "Records") -> Self:
        """Return the state of what `pack_published` has made."""
        state = cls.__new__(cls)
        object.__setattr__(state, "stamp_ns", stamp_ns)  # it is frozen
        object.__setattr__(state, "_packed", (packed, records))
        return state

    def __getattr__(self, name: str) -> object:
        """Unpack the state: a field has been asked for that is not there yet."""
        if name not in UNPACKED:
            raise AttributeError(name)
        packed, records = self._packed
        state = records.unpack_published(packed).state
        for one in UNPACKED:
            object.__setattr__(self, one, getattr(state, one))
        found: object = getattr(state, name)
        return found


class Records:
    """The layouts of one configuration, equal in both processes."""

    def __init__(self, config: Config) -> None:
        self._imu = config.imu_name
        self._messages = inputs_of(config)
        self._inputs = list(self._messages)
        self._monitored = HealthMonitor(config).names
        self._width = max([len(Geodetic._fields), *(message.WIDTH for message in self._messages.values())])
        self._request = Struct(f"<qqqqqq{self._width}d")  # epoch, sample number, kind, sensor, stamp, arrival, values
        self.healths = len(HealthMonitor(config).snapshot())
        integers = COUNTERS + 2 + self.healths  # flags, stamp; `holdfast.kernel.follower` reads what follows as well
        self._head = Struct(f"<{integers}q{1 + len(Geodetic._fields)}d{STATE_VALUES}d")
        self.sample_size, self.request_size = SAMPLE.size, self._request.size
        self.published_size = self._head.size + 8 * COVARIANCE_VALUES

    # --- samples and requests ----------------------------------------------------------------------------------------

    def pack_sample(self, epoch: int, sample: ImuSample) -> bytes:
        """Return the row of a sample of the IMU."""
        readings = *sample.specific_force.tolist(), *sample.angular_velocity.tolist()
        return SAMPLE.pack(epoch, sample.stamp_ns, sample.arrival_ns, *readings)

    def unpack_sample(self, row: bytes) -> tuple[int, ImuSample]:
        """Return the epoch and the sample of a row."""
        epoch, stamp_ns, arrival_ns, *values = SAMPLE.unpack(row)
        readings = np.array(values)
        return epoch, ImuSample(stamp_ns, arrival_ns, self._imu, readings[3:], readings[:3])

    def pack_request(self, epoch: int, samples: int, request: Request) -> bytes:
        """Return the row of a message or a request that comes after so many samples."""
        kind, sensor, stamp_ns, arrival_ns, values = MESSAGE, 0, 0, 0, tuple[float, ...]()
        if request is None:
            kind = RESET
        elif isinstance(request, Geodetic):
            kind, values = DATUM, tuple(request)
        else:
            sensor, values = self._inputs.index(request.sensor), request.values()
            stamp_ns, arrival_ns = request.stamp_ns, request.arrival_ns
        padding = (0.0,) * (self._width - len(values))
        return self._request.pack(epoch, samples, kind, sensor, stamp_ns, arrival_ns, *values, *padding)

    def unpack_request(self, row: bytes) -> tuple[int, int, Request]:
        """Return the epoch, after how many samples it came, and what it is."""
        epoch, samples, kind, sensor, stamp_ns, arrival_ns, *values = self._request.unpack(row)
        if kind == RESET:
            return epoch, samples, None
        if kind == DATUM:
            return epoch, samples, Geodetic(*values[: len(Geodetic._fields)])
        name = self._inputs[sensor]
        message = self._messages[name]
        return epoch, samples, message.of(stamp_ns, arrival_ns, name, values[: message.WIDTH])

    # --- what is published -------------------------------------------------------------------------------------------

    def pack_published(self, record: Published) -> bytes:
        """Return a record, of `published_size` bytes."""
        datum, state = record.datum, record.state
        flags = HAS_DATUM * (datum is not None) + HAS_STATE * (state is not None) + IS_LOST * record.is_lost
        stamp_ns, numbers = 0, np.zeros(STATE_VALUES + COVARIANCE_VALUES)
        if state is not None:
            stamp_ns, flags = state.stamp_ns, flags + IS_FORTRAN * bool(state.covariance.flags.f_contiguous)
            nav, bias = state.nav, state.bias
            numbers[:9] = nav.attitude().matrix().ravel()
            numbers[9:12], numbers[12:15] = nav.position(), nav.velocity()
            numbers[15:18], numbers[18:21] = bias.accelerometer(), bias.gyroscope()
            numbers[21:24] = state.angular_velocity
            numbers[24:] = state.covariance.ravel(order="F" if flags & IS_FORTRAN else "C")
        lost = sum(1 << self._monitored.index(name) for name in record.lost)
        counters = record.epoch, record.life, record.updates, record.recoveries, lost
        head = *counters, flags, stamp_ns, *record.health, record.gravity, *(datum or (0.0, 0.0, 0.0))
        return self._head.pack(*head, *numbers[:STATE_VALUES].tolist()) + numbers[STATE_VALUES:].tobytes()

    def unpack_published(self, packed: bytes) -> Published:
        """Return the record that was packed."""
        epoch, life, updates, recoveries, lost, flags, stamp_ns, *rest = self._head.unpack_from(packed)
        count = len(rest) - STATE_VALUES - 1 - len(Geodetic._fields)
        health, (gravity, *point), values = tuple(rest[:count]), rest[count : count + 4], rest[count + 4 :]
        state = None
        if flags & HAS_STATE:
            # numpy multiplies a matrix otherwise if it lies otherwise, and then the last bit differs
            order: Literal["F", "C"] = "F" if flags & IS_FORTRAN else "C"
            covariance = np.frombuffer(packed, offset=self._head.size).reshape((15, 15), order=order)
            state = _state(stamp_ns, values, covariance)
        return Published(
            epoch,
            life,
            updates,
            recoveries,
            bool(flags & IS_LOST),
            tuple(name for bit, name in enumerate(self._monitored) if lost >> bit & 1),
            health,
            gravity,
            Geodetic(*point) if flags & HAS_DATUM else None,
            state,
        )


def pack_nav(nav: gtsam.NavState) -> bytes:
    """Return a smoothed node."""
    parts = nav.attitude().matrix().ravel(), nav.position(), nav.velocity()
    return b"".join(part.tobytes() for part in parts)


def unpack_nav(packed: bytes) -> gtsam.NavState:
    """Return the node that was packed."""
    values = np.frombuffer(packed)
    return gtsam.NavState(gtsam.Rot3(values[:9].reshape(3, 3)), values[9:12], values[12:15])


def _state(stamp_ns: int, values: list[float], covariance: Array) -> OptimisedState:
    nav = gtsam.NavState(gtsam.Rot3(*values[:9]), np.array(values[9:12]), np.array(values[12:15]))
    bias = gtsam.imuBias.ConstantBias(np.array(values[15:18]), np.array(values[18:21]))
    return OptimisedState(stamp_ns, nav, bias, covariance, np.array(values[21:24]))
