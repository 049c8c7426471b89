"""What is wrong with a recording: rates, gaps, clocks, publishers, and the values that a sensor cannot mean."""

from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import RecordingError
from holdfast.messages import Array
from holdfast.recording.kinds import Findings, Kind, kinds_of
from holdfast.recording.source import Header, Recording

GAP_PERIODS = 5
BURSTS = 0.02  # of the steps between stamps are between two bursts, at least
NS_PER_S = 1_000_000_000

Stamps = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TopicFindings:
    """One topic. Times in seconds after the recording's first arrival; None where a single message is not enough.

    Attributes:
        burst_s: where stamps come in bursts, the time between these.
        kind: what it is without a configuration, None if nothing that Holdfast decodes.
        values: what was found in them, None if its kind has no findings.
    """

    topic: str
    type: str
    count: int
    rate_hz: float | None
    duration_s: float
    gaps: int
    longest_gap_s: float | None
    longest_gap_at_s: float | None
    burst_s: float | None
    stamps_back: int
    duplicate_stamps: int
    arrived_before_stamp: int
    latency_mean_s: float | None
    latency_sigma_s: float | None
    publishers: tuple[str, ...]
    frame_ids: tuple[str, ...]
    interleaved: bool
    kind: str | None
    values: Findings | None


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
    """What is kept of a topic while reading: 16 bytes a message, and its values where its kind has a check."""

    kind: Kind | None
    factors: Array | float
    stamps: "array[int]" = field(default_factory=lambda: array("q"))
    arrivals: "array[int]" = field(default_factory=lambda: array("q"))
    count: int = 0
    publishers: Counter[str] = field(default_factory=Counter)
    frame_ids: Counter[str] = field(default_factory=Counter)
    measured: "array[int]" = field(default_factory=lambda: array("q"))
    values: "array[float]" = field(default_factory=lambda: array("d"))

    def add(self, header: Header) -> None:
        self.count += 1
        self.publishers[header.publisher] += 1
        self.frame_ids[header.frame_id] += 1
        self.arrivals.append(header.arrival_ns)
        self.stamps.append(header.arrival_ns if header.stamp_ns is None else header.stamp_ns)
        if self.kind is not None and self.kind.check is not None and isinstance(header.message, self.kind.message):
            self.measured.append(header.message.stamp_ns)
            self.values.extend(header.message.values())

    def findings(self, start_ns: int) -> Findings | None:
        if self.kind is None or self.kind.check is None:
            return None
        values = np.array(self.values, dtype=np.float64).reshape(-1, self.kind.message.WIDTH) * self.factors
        return self.kind.check(np.array(self.measured, dtype=np.int64), values, start_ns)


def inspect(
    recording: Recording,
    start_s: float = 0.0,
    duration_s: float | None = None,
    progress: Callable[[int], None] | None = None,
    factors: Mapping[str, Array] | None = None,
) -> Inspection:
    """Read a recording once and list what it holds.

    Args:
        recording: an open recording.
        start_s: as in `Recording.read`.
        duration_s: as in `Recording.read`.
        progress: is called with the arrival [ns] now and then.
        factors: by which the values of some topics are multiplied, by topic.

    Raises:
        RecordingError: the window is empty. Damage further in ends the reading and is part of the result.
    """
    headers = recording.read_headers(start_s, duration_s)
    logs = {
        info.topic: _TopicLog(next(iter(kinds_of(info.type)), None), (factors or {}).get(info.topic, 1.0))
        for info in recording.topics
    }
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
    latency_s = _seconds_between(stamps, np.array(log.arrivals, dtype=np.int64))
    steps = np.diff(stamps)
    ordered = np.unique(stamps)
    periods = np.diff(ordered)
    burst_s = _burst_s(periods)
    gaps, longest_s, at_s = _gaps(ordered, start_ns, burst_s)
    values = log.findings(start_ns)
    has_header = bool(log.count) and bool(latency_s.any())
    return TopicFindings(
        topic=topic,
        type=type_name,
        count=log.count,
        rate_hz=float(NS_PER_S / (np.median(periods) if burst_s is None else periods.mean())) if periods.size else None,
        duration_s=float(ordered[-1] - ordered[0]) / NS_PER_S if ordered.size else 0.0,
        gaps=gaps,
        longest_gap_s=longest_s,
        longest_gap_at_s=at_s,
        burst_s=burst_s,
        stamps_back=int((steps < 0).sum()),
        duplicate_stamps=int(stamps.size - ordered.size),
        arrived_before_stamp=int((latency_s < 0).sum()),
        latency_mean_s=float(latency_s.mean()) if has_header else None,
        latency_sigma_s=float(latency_s.std()) if has_header else None,
        publishers=tuple(sorted(log.publishers)),
        frame_ids=tuple(sorted(log.frame_ids)),
        interleaved=are_interleaved(stamps),
        kind=_kind_of(type_name, values),
        values=values,
    )


def _seconds_between(before: Stamps, after: Stamps) -> NDArray[np.float64]:
    """Return differences (N,) [s]: in nanoseconds they may have 65 bits, as floats the times lack the last 256 ns."""
    return (after // NS_PER_S - before // NS_PER_S) + (after % NS_PER_S - before % NS_PER_S) / NS_PER_S


def _kind_of(type_name: str, values: Findings | None) -> str | None:
    """Return what a topic is: an Imu message without rates and forces, and so without findings, is a heading."""
    kinds = [kind for kind in kinds_of(type_name) if kind.check is None or values is not None]
    return kinds[0].name if kinds else None


def _burst_s(periods: Stamps) -> float | None:
    """Return the time between bursts of stamps [s]: half of the time lies in long steps, that are often and alike."""
    long = periods[periods > GAP_PERIODS * np.median(periods)] if periods.size else periods
    if long.size <= BURSTS * periods.size or 2 * long.sum() < periods.sum():
        return None
    usual_ns = float(np.median(long))
    alike = np.abs(long - usual_ns) < 0.3 * usual_ns
    return usual_ns / NS_PER_S if alike.mean() > 0.8 else None


def _gaps(ordered: Stamps, start_ns: int, burst_s: float | None) -> tuple[int, float | None, float | None]:
    """Return the number of steps above 5 median periods or bursts, the longest step [s] and where it begins [s]."""
    periods = np.diff(ordered)
    if not periods.size:
        return 0, None, None
    longest = int(periods.argmax())
    usual_ns = np.median(periods) if burst_s is None else burst_s * NS_PER_S
    number = int((periods > GAP_PERIODS * usual_ns).sum())
    return number, float(periods[longest]) / NS_PER_S, max(0.0, (int(ordered[longest]) - start_ns) / NS_PER_S)


def are_interleaved(stamps: Stamps) -> bool:
    """Return whether stamps [ns], in order of arrival, are clearly those of two publishers.

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
