"""How samples, measurements and optimised states lie in the shared memory: fixed lengths, every bit of a float kept."""

from dataclasses import dataclass
from struct import Struct

import gtsam
import numpy as np

from holdfast.geometry.earth import Geodetic
from holdfast.messages import Array, FixStatus, GnssFix, Heading, ImuSample, LidarPose
from holdfast.state import OptimisedState

SENSORS = ("gnss", "gnss_right", "heading", "lidar")
FIX, HEADING, LIDAR, RESET, DATUM = range(5)  # kinds of rows in the ring of measurements
VALUES = 43  # of a row: 7 and a covariance (6, 6) of a lidar pose, the longest

SAMPLE = Struct("<qqq6d")  # epoch, stamp, arrival, readings
REQUEST = Struct(f"<qqqqqqq{VALUES}d")  # epoch, sample number, kind, sensor, flag, stamp, arrival, values
_HEAD = Struct("<14q4d24d")  # counters, gravity and datum, state; the covariance follows

Request = GnssFix | Heading | LidarPose | Geodetic | None
"""What the optimiser may be asked to take in: a measurement, a datum to begin anew at, or None for a reset."""


def pack_sample(epoch: int, sample: ImuSample) -> bytes:
    """Return the row of a sample of the IMU."""
    rates, forces = sample.angular_velocity.tolist(), sample.specific_force.tolist()
    return SAMPLE.pack(epoch, sample.stamp_ns, sample.arrival_ns, *rates, *forces)


def unpack_sample(row: bytes) -> tuple[int, ImuSample]:
    """Return the epoch and the sample of a row."""
    epoch, stamp_ns, arrival_ns, *readings = SAMPLE.unpack(row)
    values = np.array(readings)
    return epoch, ImuSample(stamp_ns, arrival_ns, "imu", values[:3], values[3:])


def pack_request(epoch: int, samples: int, request: Request) -> bytes:
    """Return the row of a measurement or a request that comes after so many samples."""
    kind, sensor, flag, times, values = _parts(request)
    padding = (0.0,) * (VALUES - len(values))
    return REQUEST.pack(epoch, samples, kind, sensor, flag, *times, *values, *padding)


def _parts(request: Request) -> tuple[int, int, int, tuple[int, int], tuple[float, ...]]:
    if request is None:
        return RESET, 0, 0, (0, 0), ()
    if isinstance(request, Geodetic):
        return DATUM, 0, 0, (0, 0), tuple(request)
    sensor, times = SENSORS.index(request.sensor), (request.stamp_ns, request.arrival_ns)
    if isinstance(request, Heading):
        return HEADING, sensor, request.sigma_rad is not None, times, (request.yaw_rad, request.sigma_rad or 0.0)
    covariance = () if request.covariance is None else request.covariance.ravel().tolist()
    if isinstance(request, GnssFix):
        place = request.latitude_deg, request.longitude_deg, request.altitude_m
        return FIX, sensor, int(request.status) * 2 + bool(covariance), times, (*place, *covariance)
    pose = *request.position.tolist(), *request.quaternion.tolist()
    return LIDAR, sensor, bool(covariance), times, (*pose, *covariance)


def unpack_request(row: bytes) -> tuple[int, int, Request]:
    """Return the epoch, after how many samples it came, and what it is."""
    epoch, samples, kind, sensor, flag, stamp_ns, arrival_ns, *values = REQUEST.unpack(row)
    return epoch, samples, _request(kind, flag, (stamp_ns, arrival_ns, SENSORS[sensor]), values)


def _request(kind: int, flag: int, head: tuple[int, int, str], values: list[float]) -> Request:
    if kind == RESET:
        return None
    if kind == DATUM:
        return Geodetic(values[0], values[1], values[2])
    if kind == FIX:
        covariance = np.array(values[3:12]).reshape(3, 3) if flag % 2 else None
        return GnssFix(*head, values[0], values[1], values[2], covariance, FixStatus(flag // 2))
    if kind == HEADING:
        return Heading(*head, values[0], values[1] if flag else None)
    if kind == LIDAR:
        covariance = np.array(values[7:43]).reshape(6, 6) if flag else None
        return LidarPose(*head, np.array(values[:3]), np.array(values[3:7]), covariance)
    raise ValueError(f"a row of unknown kind {kind}")


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """What the optimiser publishes after each optimisation.

    Attributes:
        epoch: how often the IMU path had begun anew; a record of an earlier epoch is void.
        life: how often a first state was found.
        updates: how many optimisations there were.
        recoveries: how often GNSS was regained.
        lost: bits of the antennas that are not trusted; the third one says that no antenna is.
        health: what `HealthMonitor.snapshot` says.
        gravity: in m/s^2.
        datum: of W, None until there is one.
        state: the newest node, None before the start.
    """

    epoch: int
    life: int
    updates: int
    recoveries: int
    lost: int
    health: tuple[int, ...]
    gravity: float
    datum: Geodetic | None
    state: OptimisedState | None

    def pack(self) -> bytes:
        """Return the record, of `SIZE` bytes."""
        datum, state = self.datum or (0.0, 0.0, 0.0), self.state
        flags = 1 * (self.datum is not None) + 2 * (state is not None)
        stamp_ns, numbers = 0, np.zeros(24 + 225)
        if state is not None:
            stamp_ns, flags = state.stamp_ns, flags + 4 * bool(state.covariance.flags.f_contiguous)
            nav, bias = state.nav, state.bias
            numbers[:9] = nav.attitude().matrix().ravel()
            numbers[9:12], numbers[12:15] = nav.position(), nav.velocity()
            numbers[15:18], numbers[18:21] = bias.accelerometer(), bias.gyroscope()
            numbers[21:24] = state.angular_velocity
            numbers[24:] = state.covariance.ravel(order="F" if flags & 4 else "C")
        counters = self.epoch, self.life, self.updates, self.recoveries, self.lost
        head = *counters, flags, stamp_ns, *self.health, self.gravity, *datum
        return _HEAD.pack(*head, *numbers[:24].tolist()) + numbers[24:].tobytes()

    @staticmethod
    def unpack(record: bytes) -> "Published":
        """Return what a record says."""
        epoch, life, updates, recoveries, lost, flags, stamp_ns, *rest = _HEAD.unpack_from(record)
        health, (gravity, *place), values = tuple(rest[:7]), rest[7:11], rest[11:]
        datum = Geodetic(*place) if flags & 1 else None
        state = None
        if flags & 2:
            # numpy multiplies a matrix otherwise if it lies otherwise, and then the last bit differs
            covariance = np.frombuffer(record, offset=_HEAD.size).reshape((15, 15), order="F" if flags & 4 else "C")
            state = _state(stamp_ns, values, covariance)
        return Published(epoch, life, updates, recoveries, lost, health, gravity, datum, state)


SIZE = _HEAD.size + 8 * 225


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
