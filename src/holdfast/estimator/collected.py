"""What was measured of late, beside the graphs, from which an estimate can start: by the IMU's clock."""

from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from holdfast.estimator.odometry_tracks import OdometryTracks
from holdfast.estimator.pose_as_point import as_position
from holdfast.estimator.spacing import Spacing
from holdfast.integrity.exchanges import Pair
from holdfast.measured_fields import NEVER_NS
from holdfast.sensors.clock import is_by_gnss_clock, measured_later
from holdfast.sensors.odometry import TrackPose
from holdfast.sensors.sensor import Measurement, Position, Role, Sensor, Velocity

FEW, MOST_NS = 8, 120_000_000_000  # positions, where they are rare, but no longer
Point = TypeVar("Point", Position, Velocity)
Kind = TypeVar("Kind", bound=Measurement)


class Collected:
    """The newest measurements of all sensors.

    Args:
        sensors: all models, by name.
        points: where positions are of, in the order of their worth, by name of their sensor.
        odometries: takes the poses of these.
        window_ns: how long they are kept, or longer where positions are rare.

    Attributes:
        positions: in the order of arrival.
        all_positions: those that were forgotten, too: an arm is a constant.
        velocities: in the order of arrival.
        others: headings and poses, by sensor.
        newest_ns: the latest stamp.
        clock_ns: by how much stamps of GNSS are early: it is added to those of all that comes and is kept.
    """

    def __init__(
        self, sensors: Mapping[str, Sensor], points: Collection[str], odometries: OdometryTracks, window_ns: int
    ) -> None:
        self._sensors, self._points, self._odometries, self._window_ns = sensors, points, odometries, window_ns
        self.positions: deque[Position] = deque()
        self.all_positions: deque[Position] = deque()
        self.velocities: deque[Velocity] = deque()
        self.others: dict[str, deque[Any]] = {}
        self.newest_ns = NEVER_NS
        self.clock_ns = 0
        self._spacings = {name: Spacing() for name in points}

    def add(self, measurement: Measurement) -> None:
        """Take in a measurement, and forget what is too old beside it."""
        role = self._sensors[measurement.sensor].role
        measurement = self._later(measurement, self.clock_ns)
        if role is Role.POSITION and isinstance(measurement, Position):
            self.positions.append(measurement)
            self.all_positions.append(measurement)
            self._spacings[measurement.sensor].add(measurement.stamp_ns)
        elif role is Role.VELOCITY and isinstance(measurement, Velocity):
            self.velocities.append(measurement)
        elif role is Role.ODOMETRY and isinstance(measurement, TrackPose):
            self._odometries.add(measurement)
        elif role is not Role.STATE:
            self.others.setdefault(measurement.sensor, deque()).append(measurement)
        if role is Role.POSE and measurement.sensor in self._points:
            self.positions.append(as_position(measurement))
        self.newest_ns = max(self.newest_ns, measurement.stamp_ns)
        horizon_ns = self.newest_ns - self.longest_ns
        self.forget_before(horizon_ns)
        _forget(self.all_positions, horizon_ns)

    @property
    def longest_ns(self) -> int:
        """The longest stretch that is kept."""
        spacing_ns = min((one.spacing_ns for one in self._spacings.values()), default=0)
        return max(self._window_ns, min(FEW * spacing_ns, MOST_NS))

    @property
    def _series(self) -> list[deque[Any]]:
        """All that is kept, but for `all_positions`."""
        return [self.positions, self.velocities, *self.others.values(), *self._odometries.series]

    def forget_before(self, stamp_ns: int) -> None:
        """Forget what was measured before a time."""
        for series in self._series:
            _forget(series, stamp_ns)

    def forget_after(self, stamp_ns: int) -> None:
        """Forget what was measured after a time: by a clock that was wrong."""
        for series in (self.all_positions, *self._series):
            _refill(series, [one for one in series if one.stamp_ns <= stamp_ns])
        self.newest_ns = min(self.newest_ns, stamp_ns)

    def know_clock(self, clock_ns: int) -> None:
        """Know by how much stamps of GNSS are early, in what has come, too."""
        later_ns, self.clock_ns = clock_ns - self.clock_ns, clock_ns
        self.stamp_later(later_ns)

    def stamp_later(self, by_ns: int) -> None:
        """Know that all that has come by the clock of GNSS was measured later than it was stamped."""
        for series in (self.all_positions, *self._series):
            _refill(series, [self._later(one, by_ns) for one in series])

    def exchange(self, pair: Pair, since_ns: int = NEVER_NS) -> None:
        """Know that two antennas' positions have come by each other's name since a time."""
        for series in self.positions, self.all_positions:
            _refill(series, exchanged(series, pair, since_ns))

    def _later(self, one: Kind, by_ns: int) -> Kind:
        """Return a measurement, if it is by the clock of GNSS, as one that was taken later."""
        return measured_later(one, by_ns) if is_by_gnss_clock(self._sensors[one.sensor]) else one

    def of_receiver(self, name: str, since_ns: int = NEVER_NS) -> list[Position]:
        """Return the positions of a receiver since a time, in the order of arrival."""
        return [one for one in self.positions if one.sensor == name and one.stamp_ns >= since_ns]

    def of_first_receiver(self, since_ns: int = NEVER_NS) -> list[Position]:
        """Return the positions of the first receiver that has any since a time."""
        return next((found for name in self._points if (found := self.of_receiver(name, since_ns))), [])

    def velocities_of(self, sensors: Collection[str]) -> list[Velocity]:
        """Return the velocities of some sensors."""
        return [one for one in self.velocities if one.sensor in sensors]

    def newest_of(self, sensors: Collection[str]) -> Iterator[Any]:
        """Yield the newest heading or pose of each of some sensors."""
        for name, series in self.others.items():
            if series and name in sensors:
                yield series[-1]


def between(measurements: Iterable[Point], start_ns: int, end_ns: int) -> list[Point]:
    """Return measurements after a time, until another, by stamp."""
    return sorted((one for one in measurements if start_ns < one.stamp_ns <= end_ns), key=lambda one: one.stamp_ns)


def exchanged(positions: Iterable[Position], pair: Pair, since_ns: int = NEVER_NS) -> list[Position]:
    """Return positions, those of two antennas since a time by each other's name."""
    other = {pair[0]: pair[1], pair[1]: pair[0]}
    return [
        replace(one, sensor=other[one.sensor]) if one.sensor in other and one.stamp_ns >= since_ns else one
        for one in positions
    ]


def _refill(series: deque[Any], of: Sequence[Any]) -> None:
    series.clear()
    series.extend(of)


def _forget(series: deque[Any], horizon_ns: int) -> None:
    while series and series[0].stamp_ns < horizon_ns:
        series.popleft()
