"""A folder of CSV files, one per topic: the file's stem is the topic, its header names columns with their units.

The format is documented in docs/recordings.md; the header of EuRoC's IMU files is understood as well.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path

import numpy as np

from holdfast.errors import RecordingError
from holdfast.messages import FixStatus, GnssFix, Heading, ImuSample, JointAngle, LidarPose, Message
from holdfast.recording.decode import STATUSES, UndecodableError, normalised
from holdfast.recording.merge import SkippedMessages
from holdfast.recording.source import Kind, TopicInfo
from holdfast.recording.tracks import TrackRecording, last_line

Build = Callable[[int, int, str, list[float]], Message]
"""Takes stamp [ns], arrival [ns], sensor and the values of the columns in the order of the layout."""


@dataclass(frozen=True, slots=True)
class Layout:
    """The columns of one kind of file; the optional ones come all or not at all and may be left empty."""

    kind: Kind
    type: str
    columns: tuple[str, ...]
    optional: tuple[str, ...]
    build: Build


def _imu(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> Message:
    return ImuSample(stamp_ns, arrival_ns, sensor, np.array(v[:3]), np.array(v[3:]))


def _gnss(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> Message:
    variances = [sigma * sigma for sigma in v[4:]]
    known = any(variances) and all(map(isfinite, variances))
    covariance = np.diag(variances) if known else None
    status = STATUSES.get(int(v[3]), FixStatus.UNKNOWN) if isfinite(v[3]) else FixStatus.UNKNOWN
    return GnssFix(stamp_ns, arrival_ns, sensor, v[0], v[1], v[2], covariance, status)


def _lidar(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> Message:
    if not all(map(isfinite, v[:3])):
        raise UndecodableError("position is not finite")
    return LidarPose(stamp_ns, arrival_ns, sensor, np.array(v[:3]), normalised(np.array(v[3:])), None)


def _heading(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> Message:
    if not isfinite(v[0]):
        raise UndecodableError("yaw is not finite")
    sigma_rad = v[1] if len(v) > 1 and isfinite(v[1]) and v[1] > 0 else None
    return Heading(stamp_ns, arrival_ns, sensor, v[0], sigma_rad)


def _joint(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> Message:
    if not isfinite(v[0]):
        raise UndecodableError("angle is not finite")
    return JointAngle(stamp_ns, arrival_ns, sensor, v[0])


LAYOUTS = (
    Layout(
        "imu",
        "sensor_msgs/msg/Imu",
        ("wx_rad_s", "wy_rad_s", "wz_rad_s", "ax_m_s2", "ay_m_s2", "az_m_s2"),
        (),
        _imu,
    ),
    Layout(
        "gnss",
        "sensor_msgs/msg/NavSatFix",
        ("latitude_deg", "longitude_deg", "altitude_m", "status"),
        ("sigma_east_m", "sigma_north_m", "sigma_up_m"),
        _gnss,
    ),
    Layout("lidar", "geometry_msgs/msg/PoseStamped", ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"), (), _lidar),
    Layout("heading", "geometry_msgs/msg/QuaternionStamped", ("yaw_rad",), ("sigma_rad",), _heading),
    Layout("joint", "sensor_msgs/msg/JointState", ("angle_rad",), (), _joint),
)
STAMP, ARRIVAL = "stamp_ns", "arrival_ns"
EUROC = {
    "timestamp": STAMP,
    **{f"w_RS_S_{axis}": f"w{axis}_rad_s" for axis in "xyz"},
    **{f"a_RS_S_{axis}": f"a{axis}_m_s2" for axis in "xyz"},
}


def open_files(path: Path, files: Sequence[Path]) -> TrackRecording:
    """Open a folder of CSV files; those without any column that is known are left out with a warning.

    Raises:
        RecordingError: a header or the first line of a file cannot be read, or no file has a line.
    """
    tracks: list[CsvTrack] = []
    foreign: list[_ForeignFileError] = []
    for file in files:
        try:
            tracks.append(CsvTrack(file))
        except _ForeignFileError as error:
            foreign.append(error)
    if not tracks:
        raise foreign[0]
    recording = TrackRecording(path, tracks)
    recording.warnings += [f"{error}; the file is left out" for error in foreign]
    return recording


class _ForeignFileError(RecordingError):
    """A CSV file that has nothing to do with Holdfast."""


class CsvTrack:
    """One CSV file; see `holdfast.recording.tracks.Track`.

    Raises:
        RecordingError: the header names columns that are unknown or misses some; or the first line cannot be read.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        with file.open(encoding="utf-8-sig", errors="replace") as stream:
            header = stream.readline()
        self._names = [_column_name(name) for name in header.split(",")]
        self._layout = self._find_layout()
        self.kind: str = self._layout.kind
        self.info = TopicInfo(file.stem, self._layout.type, None)
        wanted = self._layout.columns + tuple(name for name in self._layout.optional if name in self._names)
        self._optional = frozenset(self._layout.optional)
        self._values = [(self._names.index(name), name) for name in wanted]
        self._stamp = self._names.index(STAMP)
        self._arrival = self._names.index(ARRIVAL) if ARRIVAL in self._names else self._stamp
        self.start_ns = next((self._times(cells, line)[1] for line, cells, _ in self._lines()), None)
        self.end_ns = None if self.start_ns is None else self._last_arrival()

    def messages(self, sensor: str, skipped: SkippedMessages, warnings: list[str]) -> Iterator[Message]:
        """Read the file line by line; see `Track.messages`. A last line that was cut off is a warning."""
        build = self._layout.build
        for line, cells, whole in self._lines():
            try:
                stamp_ns, arrival_ns = self._times(cells, line)
                values = self._parse(cells, line)
            except RecordingError as error:
                if whole:
                    raise
                warnings.append(f"{error}; the line is the last one and was cut off, so it is left out")
                return
            try:
                yield build(stamp_ns, arrival_ns, sensor, values)
            except UndecodableError as error:
                skipped.add(self.info.topic, arrival_ns, error)

    def _find_layout(self) -> Layout:
        names = set(self._names)
        layout = max(LAYOUTS, key=lambda layout: len(names & set(layout.columns)))
        allowed = [STAMP, *layout.columns, ARRIVAL, *layout.optional]
        place = f"{self.file}:1"
        if not names & set(layout.columns):
            first = "; ".join(f"{layout.kind}: {', '.join(layout.columns)}" for layout in LAYOUTS)
            raise _ForeignFileError(f"{place}: the header names no known column (allowed: {STAMP} and one of {first})")
        optional = layout.optional if names & set(layout.optional) else ()
        missing = [name for name in (STAMP, *layout.columns, *optional) if name not in names]
        if missing:
            raise RecordingError(
                f"{place}: column {missing[0]} is missing (a {layout.kind} file has {', '.join(allowed)})"
            )
        unknown = [name for name in self._names if name not in allowed or self._names.count(name) > 1]
        if unknown:
            raise RecordingError(
                f"{place}: column {unknown[0]!r} is unknown or there twice (allowed: {', '.join(allowed)})"
            )
        return layout

    def _lines(self) -> Iterator[tuple[int, list[str], bool]]:
        """Yield the line's number, its cells, and whether it ends as a line should."""
        with self.file.open(encoding="utf-8-sig", errors="replace") as stream:
            next(stream)
            for number, line in enumerate(stream, start=2):
                if line.strip() and line[0] != "#":
                    yield number, line.split(","), line.endswith("\n")

    def _times(self, cells: list[str], line: int) -> tuple[int, int]:
        if len(cells) != len(self._names):
            raise RecordingError(
                f"{self.file}:{line}: has {len(cells)} columns (allowed: {len(self._names)}, as above)"
            )
        try:
            return int(cells[self._stamp]), int(cells[self._arrival])
        except ValueError:
            bad = STAMP if not _is_integer(cells[self._stamp]) else ARRIVAL
            text = cells[self._names.index(bad)].strip()
            raise RecordingError(
                f"{self.file}:{line}: column {bad} is {text!r} (allowed: a whole number of nanoseconds)"
            ) from None

    def _parse(self, cells: list[str], line: int) -> list[float]:
        try:
            return [float(cells[index]) for index, _ in self._values]
        except ValueError:
            return [self._parse_cell(cells[index].strip(), name, line) for index, name in self._values]

    def _parse_cell(self, text: str, name: str, line: int) -> float:
        if not text and name in self._optional:
            return nan
        try:
            return float(text)
        except ValueError:
            raise RecordingError(
                f"{self.file}:{line}: column {name} is {text!r} (allowed: a number"
                + (" or nothing)" if name in self._optional else ", nan if it is unknown)")
            ) from None

    def _last_arrival(self) -> int | None:
        try:
            return self._times(last_line(self.file).split(","), 0)[1]
        except RecordingError:
            return None


def _column_name(text: str) -> str:
    """Return a column's name; EuRoC's `#timestamp [ns]` and `w_RS_S_x [rad s^-1]` are translated."""
    bare = re.sub(r"\s*\[.*\]\s*$", "", text.strip()).lstrip("# ")
    return EUROC.get(bare, text.strip().lstrip("# "))


def _is_integer(text: str) -> bool:
    try:
        int(text)
    except ValueError:
        return False
    return True
