"""What is wrong with a recording: rates, gaps, clocks, publishers, and the values that an IMU or a GNSS cannot mean."""

from array import array
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import RecordingError
from holdfast.messages import Array, GnssFix, ImuSample
from holdfast.recording.source import Header, Recording

GAP_PERIODS = 5
LINE_SAMPLES = 4
LINE_TOLERANCE = 1e-6
"""Second differences [rad/s, m/s^2] below this are zero: far under any sensor's noise, and yet above what the jitter of
the stamps leaves of a line drawn over time (on the KITTI drive all tolerances from 1e-7 to 1e-4 find the same 8 lines).
"""
NS_PER_S = 1e9

Stamps = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ImuFindings:
    """Samples that an IMU cannot have measured; lines are runs of 4 or more samples on a line in all six channels."""

    repeats: int
    not_finite: int
    lines: int
    line_samples: int
    longest_line_s: float
    longest_line_at_s: float


@dataclass(frozen=True, slots=True)
class GnssFindings:
    """Quality that the receiver claims; sigmas are horizontal, the worse of east and north [m], None if all unknown."""

    statuses: dict[str, int]
    not_finite: int
    unknown_covariances: int
    smallest_sigma_m: float | None
    largest_sigma_m: float | None


@dataclass(frozen=True, slots=True)
class TopicFindings:
    """One topic. Times in seconds after the recording's first arrival; None where a single message does not tell."""

    topic: str
    type: str
    count: int
    rate_hz: float | None
    duration_s: float
    gaps: int
    longest_gap_s: float | None
    longest_gap_at_s: float | None
    stamps_back: int
    duplicate_stamps: int
    arrived_before_stamp: int
    latency_mean_s: float | None
    latency_sigma_s: float | None
    publishers: tuple[str, ...]
    frame_ids: tuple[str, ...]
    interleaved: bool
    imu: ImuFindings | None
    gnss: GnssFindings | None


@dataclass(frozen=True, slots=True)
class Inspection:
    """A whole recording; `damage` is the error that ended the reading early."""

    path: str
    start_ns: int | None
    end_ns: int | None
    topics: tuple[TopicFindings, ...]
    warnings: tuple[str, ...]
    damage: RecordingError | None


@dataclass(slots=True)
class _TopicLog:
    """What is remembered of a topic while reading: 16 bytes a message, 64 if it is an IMU's."""

    stamps: "array[int]" = field(default_factory=lambda: array("q"))
    arrivals: "array[int]" = field(default_factory=lambda: array("q"))
    count: int = 0
    publishers: Counter[str] = field(default_factory=Counter)
    frame_ids: Counter[str] = field(default_factory=Counter)
    imu_stamps: "array[int]" = field(default_factory=lambda: array("q"))
    imu: "array[float]" = field(default_factory=lambda: array("d"))
    statuses: Counter[str] = field(default_factory=Counter)
    lost_fixes: int = 0
    unknown_covariances: int = 0
    variances: "array[float]" = field(default_factory=lambda: array("d"))

    def add(self, header: Header) -> None:
        self.count += 1
        self.publishers[header.publisher] += 1
        self.frame_ids[header.frame_id] += 1
        self.arrivals.append(header.arrival_ns)
        self.stamps.append(header.arrival_ns if header.stamp_ns is None else header.stamp_ns)
        message = header.message
        if isinstance(message, ImuSample):
            self.imu_stamps.append(message.stamp_ns)
            self.imu.extend(message.angular_velocity.tolist())
            self.imu.extend(message.specific_force.tolist())
        elif isinstance(message, GnssFix):
            self._add_fix(message)

    def _add_fix(self, fix: GnssFix) -> None:
        self.statuses[fix.status.name.lower()] += 1
        self.lost_fixes += not np.isfinite((fix.latitude_deg, fix.longitude_deg, fix.altitude_m)).all()
        if fix.covariance is None:
            self.unknown_covariances += 1
        else:
            self.variances.append(max(fix.covariance[0, 0], fix.covariance[1, 1]))


def inspect(
    recording: Recording,
    start_s: float = 0.0,
    duration_s: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Inspection:
    """Read a recording once and list what it holds.

    Args:
        recording: an open recording.
        start_s: as in `Recording.read`.
        duration_s: as in `Recording.read`.
        progress: is called with the arrival [ns] now and then.

    Raises:
        RecordingError: the window is empty. Damage further in ends the reading and is part of the result.
    """
    headers = recording.read_headers(start_s, duration_s)
    logs = {info.topic: _TopicLog() for info in recording.topics}
    damage = None
    try:
        for number, header in enumerate(headers):
            logs[header.topic].add(header)
            if progress is not None and number % 2000 == 0:
                progress(header.arrival_ns)
    except RecordingError as error:
        damage = error
    start_ns = recording.start_ns or 0
    topics = tuple(_find(info.topic, info.type, logs[info.topic], start_ns) for info in recording.topics)
    return Inspection(
        str(recording.path), recording.start_ns, recording.end_ns, topics, tuple(recording.warnings), damage
    )


def _find(topic: str, type_name: str, log: _TopicLog, start_ns: int) -> TopicFindings:
    stamps = np.array(log.stamps, dtype=np.int64)
    latency_s = (np.array(log.arrivals, dtype=np.int64) - stamps) / NS_PER_S
    steps = np.diff(stamps)
    ordered = np.unique(stamps)
    gaps, longest_s, at_s = _gaps(ordered, start_ns)
    periods = np.diff(ordered)
    has_header = bool(log.count) and bool(latency_s.any())
    return TopicFindings(
        topic=topic,
        type=type_name,
        count=log.count,
        rate_hz=float(NS_PER_S / np.median(periods)) if periods.size else None,
        duration_s=float(ordered[-1] - ordered[0]) / NS_PER_S if ordered.size else 0.0,
        gaps=gaps,
        longest_gap_s=longest_s,
        longest_gap_at_s=at_s,
        stamps_back=int((steps < 0).sum()),
        duplicate_stamps=int(stamps.size - ordered.size),
        arrived_before_stamp=int((latency_s < 0).sum()),
        latency_mean_s=float(latency_s.mean()) if has_header else None,
        latency_sigma_s=float(latency_s.std()) if has_header else None,
        publishers=tuple(sorted(log.publishers)),
        frame_ids=tuple(sorted(log.frame_ids)),
        interleaved=are_interleaved(stamps),
        imu=_find_imu(log, start_ns) if any(log.imu) else None,  # all zero: the message holds an orientation alone
        gnss=_find_gnss(log) if log.statuses else None,
    )


def _gaps(ordered: Stamps, start_ns: int) -> tuple[int, float | None, float | None]:
    """Return the number of steps above 5 median periods, the longest step [s] and where it begins [s]."""
    periods = np.diff(ordered)
    if not periods.size:
        return 0, None, None
    longest = int(periods.argmax())
    number = int((periods > GAP_PERIODS * np.median(periods)).sum())
    return number, float(periods[longest]) / NS_PER_S, max(0.0, float(ordered[longest] - start_ns) / NS_PER_S)


def are_interleaved(stamps: Stamps) -> bool:
    """Tell whether stamps [ns], in order of arrival, are clearly those of two publishers.

    Either every tenth stamp or more jumps back (two clocks), or steps alternate between short and long while every
    second stamp keeps an even pace (one clock, two publishers out of step).
    """
    if stamps.size < 20:
        return False
    steps = np.diff(stamps).astype(np.float64)
    if (steps < 0).mean() > 0.1:
        return True
    pairs = (stamps[2:] - stamps[:-2]).astype(np.float64)
    pace = float(np.median(pairs))
    unevenness = float(np.median(np.abs(pairs - pace)))
    alternation = float(np.median(np.abs(np.diff(steps))))
    return alternation > 0.2 * pace and unevenness < 0.05 * pace


def _find_imu(log: _TopicLog, start_ns: int) -> ImuFindings:
    values = np.array(log.imu, dtype=np.float64).reshape(-1, 6)
    stamps = np.array(log.imu_stamps, dtype=np.int64)
    lines = straight_lines(values)
    lengths_s = [float(stamps[end - 1] - stamps[begin]) / NS_PER_S for begin, end in lines]
    longest = int(np.argmax(lengths_s)) if lines else 0
    return ImuFindings(
        repeats=int((values[1:] == values[:-1]).all(axis=1).sum()),
        not_finite=int((~np.isfinite(values).all(axis=1)).sum()),
        lines=len(lines),
        line_samples=sum(end - begin for begin, end in lines),
        longest_line_s=lengths_s[longest] if lines else 0.0,
        longest_line_at_s=float(stamps[lines[longest][0]] - start_ns) / NS_PER_S if lines else 0.0,
    )


def straight_lines(values: Array) -> list[tuple[int, int]]:
    """Find runs of 4 or more samples (N, 6) whose second differences are zero in all channels though they change.

    Noise makes such a run impossible for a sensor: a logger drew it over a drop-out. Returns (begin, end) indices,
    the end exclusive. Runs without change are no lines but repeats.
    """
    first = np.diff(values, axis=0)
    with np.errstate(invalid="ignore"):
        straight = (np.abs(np.diff(first, axis=0)) <= LINE_TOLERANCE).all(axis=1)
        straight &= (np.abs(first[1:]) > LINE_TOLERANCE).any(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], straight, [False])).astype(np.int8)))
    runs = ((int(begin), int(end) + 2) for begin, end in edges.reshape(-1, 2))
    return [(begin, end) for begin, end in runs if end - begin >= LINE_SAMPLES]


def _find_gnss(log: _TopicLog) -> GnssFindings:
    sigmas = np.sqrt(np.array(log.variances, dtype=np.float64))
    return GnssFindings(
        statuses=dict(sorted(log.statuses.items())),
        not_finite=log.lost_fixes,
        unknown_covariances=log.unknown_covariances,
        smallest_sigma_m=float(sigmas.min()) if sigmas.size else None,
        largest_sigma_m=float(sigmas.max()) if sigmas.size else None,
    )
