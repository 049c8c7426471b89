"""Stretches of time from the events of a replay: health, trust in each antenna, GNSS lost."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from holdfast.report.words import in_words

ANTENNAS = ("gnss", "gnss_right")


class Stretch(NamedTuple):
    """From its start to its end something was the case.

    Attributes:
        name: what: a health, `trusted` or `lost`.
        why: what began it, in words; empty where nothing did.
    """

    start_s: float
    end_s: float
    name: str
    why: str = ""


def health_stretches(events: Sequence[Mapping[str, Any]], start_ns: int, end_s: float) -> list[Stretch]:
    """Return the healths from the start of the run to its end."""
    changes = [(0.0, "initialising", "")]
    for event in events:
        if event["kind"] == "health":
            changes.append((_seconds(event, start_ns), str(event["reason"]), in_words(event)))
        elif event["kind"] == "clock_step":
            changes.append((_seconds(event, start_ns), "initialising", in_words(event)))
    return _stretches(changes, end_s)


def antenna_stretches(
    events: Sequence[Mapping[str, Any]], start_ns: int, end_s: float, heard: Mapping[str, Any]
) -> dict[str, list[Stretch]]:
    """Return trust in each antenna of which there were measurements, from the start of the estimator on."""
    begun = [event for event in events if event["kind"] == "initialised"]
    rows: dict[str, list[Stretch]] = {}
    for antenna in (name for name in ANTENNAS if name in heard and begun):
        changes = []
        for event in events:
            at_s = _seconds(event, start_ns)
            if event["kind"] == "initialised":
                changes.append((at_s, "trusted", ""))
            elif event["sensor"] == antenna and event["kind"] in ("antenna_lost", "antenna_regained"):
                changes.append((at_s, "lost" if event["kind"] == "antenna_lost" else "trusted", in_words(event)))
            elif event["sensor"] == antenna and event["kind"] == "estimate_suspect":
                changes.append((at_s, "trusted", in_words(event)))
        rows[antenna] = _stretches(changes, end_s)
    return rows


def lost_stretches(events: Sequence[Mapping[str, Any]], start_ns: int, end_s: float) -> list[Stretch]:
    """Return when no antenna was trusted."""
    lost: list[Stretch] = []
    since: tuple[float, str] | None = None
    for event in events:
        at_s = _seconds(event, start_ns)
        if event["kind"] == "gnss_lost":
            since = since or (at_s, in_words(event))
        elif event["kind"] in ("gnss_regained", "estimate_suspect", "initialised") and since is not None:
            lost.append(Stretch(since[0], at_s, "lost", since[1]))
            since = None
    return lost if since is None else [*lost, Stretch(since[0], end_s, "lost", since[1])]


def _stretches(changes: Sequence[tuple[float, str, str]], end_s: float) -> list[Stretch]:
    ends = [*(start_s for start_s, _, _ in changes[1:]), end_s]
    found = [Stretch(start_s, end, name, why) for (start_s, name, why), end in zip(changes, ends, strict=True)]
    return [stretch for stretch in found if stretch.end_s > stretch.start_s]


def _seconds(event: Mapping[str, Any], start_ns: int) -> float:
    return float((event["stamp_ns"] - start_ns) * 1e-9)
