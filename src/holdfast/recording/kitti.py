"""The KITTI drive that ships inside the gtsam wheel: 470 s of IMU and GNSS in town, without any download.

KITTI raw drive 2011_10_03_0027 (Geiger et al. 2013, CC BY-NC-SA 3.0). The IMU file hides seven drop-outs behind
straight lines, and the GNSS is 59 ms early; both are passed on as they are.
"""

from collections.abc import Iterator, Sequence
from decimal import Decimal
from importlib.util import find_spec
from math import isfinite
from pathlib import Path

import numpy as np

from holdfast.errors import RecordingError
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.messages import FixStatus, GnssFix, ImuSample, Message
from holdfast.recording.plain_numbers import check_plain
from holdfast.recording.source import TopicInfo
from holdfast.recording.tracks import TrackRecording, last_line

IMU_FILE, GNSS_FILE = "KittiEquivBiasedImu.txt", "KittiGps_converted.txt"
EPOCH_OF_FILE_NS = 1_317_554_000_000_000_000
"""The files count seconds of the day in which 0 is this time; so the drive keeps its date, 3 October 2011."""
IMU_LATENCY_NS, GNSS_LATENCY_NS = 2_000_000, 120_000_000
DATUM = Geodetic(49.0, 8.4, 116.0)
"""Karlsruhe; the files leave out where their local metres begin."""
GNSS_COVARIANCE = np.diag([0.05**2, 0.05**2, 0.1**2])


def open_files(path: Path, files: Sequence[Path]) -> TrackRecording:  # noqa: ARG001
    """Open the drive; gtsam is found, not imported.

    Raises:
        RecordingError: gtsam is not installed, or its files are not those that are known.
    """
    spec = find_spec("gtsam")
    places = list(spec.submodule_search_locations or []) if spec is not None else []
    folder = next((Path(place) / "Data" for place in places if (Path(place) / "Data" / IMU_FILE).exists()), None)
    if folder is None:
        raise RecordingError(f"{path}: the installed gtsam has no Data/{IMU_FILE} (allowed: a gtsam wheel 4.3)")
    return TrackRecording(path, [GnssTrack(folder / GNSS_FILE), ImuTrack(folder / IMU_FILE)])


class ImuTrack:
    """`Time dt accelX accelY accelZ omegaX omegaY omegaZ`: x forward, y left, z up; the first dt is bogus."""

    kinds: tuple[str, ...] = ("imu",)

    def __init__(self, file: Path) -> None:
        self.file = file
        self.info = TopicInfo("/imu", "sensor_msgs/msg/Imu", None)
        self.start_ns, self.end_ns = _first_and_last_arrival(file, None, IMU_LATENCY_NS)

    def messages(self, kind: str, sensor: str, skipped: object, warnings: object) -> Iterator[Message]:  # noqa: ARG002
        """Read the file line by line; see `Track.messages`."""
        for stamp_ns, (_, *force, wx, wy, wz) in _read_rows(self.file, 8, None):
            yield ImuSample(
                stamp_ns, stamp_ns + IMU_LATENCY_NS, sensor, np.array((wx, wy, wz)), np.array(force, dtype=np.float64)
            )


class GnssTrack:
    """`Time,X,Y,Z`: position of the IMU, east, north and up [m] of an origin that is taken to be `DATUM`."""

    kinds: tuple[str, ...] = ("gnss",)

    def __init__(self, file: Path) -> None:
        self.file = file
        self.info = TopicInfo("/gnss/fix", "sensor_msgs/msg/NavSatFix", None)
        self.start_ns, self.end_ns = _first_and_last_arrival(file, ",", GNSS_LATENCY_NS)

    def messages(self, kind: str, sensor: str, skipped: object, warnings: object) -> Iterator[Message]:  # noqa: ARG002
        """Read the file line by line; see `Track.messages`."""
        world = LocalFrame(DATUM)
        for stamp_ns, enu in _read_rows(self.file, 4, ","):
            point = world.to_geodetic(np.array(enu))
            covariance = GNSS_COVARIANCE.copy()
            yield GnssFix(stamp_ns, stamp_ns + GNSS_LATENCY_NS, sensor, *point, covariance, FixStatus.GBAS)


def _read_rows(file: Path, columns: int, separator: str | None) -> Iterator[tuple[int, list[float]]]:
    """Yield the stamp [ns], exact to the digits given, and the columns behind it."""
    with file.open(encoding="ascii", errors="replace") as stream:
        next(stream, None)
        for number, line in enumerate(stream, start=2):
            cells = line.split(separator)
            try:
                check_plain(cells)
                values = [float(cell) for cell in cells[1:]]
                if len(cells) != columns or not all(map(isfinite, values)):
                    raise ValueError
                yield _stamp_ns(cells[0]), values
            except (ValueError, ArithmeticError):
                raise RecordingError(f"{file}:{number}: allowed are {columns} finite numbers") from None


def _stamp_ns(seconds: str) -> int:
    return EPOCH_OF_FILE_NS + int(Decimal(seconds).scaleb(9).to_integral_value())


def _first_and_last_arrival(file: Path, separator: str | None, latency_ns: int) -> tuple[int | None, int | None]:
    columns = 8 if separator is None else 4
    first = next(_read_rows(file, columns, separator), None)
    if first is None:
        return None, None
    return first[0] + latency_ns, _stamp_ns(last_line(file).split(separator)[0]) + latency_ns
