"""Intervals of time from the events of a replay: health, trust in each sensor, GNSS lost."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from holdfast.report.words import in_words

TRUSTED = {  # what an event of a sensor changes
    "receiver_lost": False,
    "receiver_regained": True,
    "sensor_lost": False,
    "sensor_regained": True,
    "estimate_suspect": True,
}


class Interval(NamedTuple):
    """An interval in which something was the case.

    Attributes:
        name: of a health, `trusted` or `lost`.
        why: what began it, in words; empty where nothing did.
    """

    start_s: float
    end_s: float
    name: str
    why: str = ""


def health_intervals(events: Sequence[Mapping[str, Any]], start_ns: int, end_s: float) -> list[Interval]:
    """Return the healths from the start of the run to its end."""
    changes = [(0.0, "initialising", "")]
    for event in events:
        if event["kind"] == "health":
            changes.append((_seconds(event, start_ns), str(event["reason"]), in_words(event)))
        elif event["kind"] == "clock_step":
            changes.append((_seconds(event, start_ns), "initialising", in_words(event)))
    return _intervals(changes, end_s)


def trust_intervals(
    events: Sequence[Mapping[str, Any]], start_ns: int, end_s: float, sensors: Iterable[str]
) -> dict[str, list[Interval]]:
    """Return the trust in each of some sensors, from the start of the estimator on; nothing if it never started."""
    rows: dict[str, list[Interval]] = {}
    for sensor in sensors:
        changes = []
        for event in events:
            at_s = _seconds(event, start_ns)
            if event["kind"] == "initialised":
                changes.append((at_s, "trusted", ""))
            elif event["sensor"] == sensor and event["kind"] in TRUSTED and changes:
                changes.append((at_s, "trusted" if TRUSTED[event["kind"]] else "lost", in_words(event)))
        if changes:
            rows[sensor] = _intervals(changes, end_s)
    return rows


def lost_intervals(events: Sequence[Mapping[str, Any]], start_ns: int, end_s: float) -> list[Interval]:
    """Return when no receiver was trusted."""
    lost: list[Interval] = []
    since: tuple[float, str] | None = None
    for event in events:
        at_s = _seconds(event, start_ns)
        if event["kind"] == "gnss_lost":
            since = since or (at_s, in_words(event))
        elif event["kind"] in ("gnss_regained", "estimate_suspect", "initialised") and since is not None:
            lost.append(Interval(since[0], at_s, "lost", since[1]))
            since = None
    return lost if since is None else [*lost, Interval(since[0], end_s, "lost", since[1])]


def _intervals(changes: Sequence[tuple[float, str, str]], end_s: float) -> list[Interval]:
    ends = [*(start_s for start_s, _, _ in changes[1:]), end_s]
    found = [Interval(start_s, end, name, why) for (start_s, name, why), end in zip(changes, ends, strict=True)]
    return [interval for interval in found if interval.end_s > interval.start_s]


def _seconds(event: Mapping[str, Any], start_ns: int) -> float:
    return float((event["stamp_ns"] - start_ns) * 1e-9)
