"""Watches the inputs of a live node: who does not publish, what has another type, which clock is off."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import NamedTuple

from holdfast.live.dds import Publication

NS_PER_S = 1e9
MALFORMED = "malformed"


class Finding(NamedTuple):
    """What is wrong with a topic; `kind` stays the same while it is the same fault."""

    kind: str
    text: str


@dataclass(slots=True)
class Reception:
    """When messages of one topic arrived."""

    arrival_ns: int
    offset_ns: int = 0
    arrivals_ns: deque[int] = field(default_factory=lambda: deque(maxlen=200))

    def rate_hz(self, now_ns: int) -> float:
        """Return the rate of the last messages, the present silence included."""
        if len(self.arrivals_ns) < 2:
            return 0.0
        newest = max(now_ns - self.arrivals_ns[-1], 0)
        spacing = (self.arrivals_ns[-1] - self.arrivals_ns[0]) / (len(self.arrivals_ns) - 1)
        return NS_PER_S / max(spacing, newest, 1)


class Watch:
    """Judges topics by what was received and by who publishes; it knows no clock and no network of its own.

    Args:
        topics: the types that are allowed, by topic.
        silent_after_s: a publisher or a message is missing after so long.
        max_clock_offset_s: stamps may be so far from the time of arrival.
        reliable: whether the readers ask for lost samples again.
        began_ns: now, in the time of arrivals.
    """

    def __init__(
        self,
        topics: Mapping[str, Sequence[str]],
        silent_after_s: float,
        max_clock_offset_s: float,
        *,
        reliable: bool,
        began_ns: int,
    ) -> None:
        self._topics = topics
        self._silent_after_s = silent_after_s
        self._max_clock_offset_s = max_clock_offset_s
        self._reliable = reliable
        self.received = {topic: Reception(began_ns) for topic in topics}
        self._here_since_ns: dict[str, int] = {}  # when the publishers that there are were first seen
        self._malformed: dict[str, int] = {}

    def note(self, topic: str, stamp_ns: int, arrival_ns: int, clock_ns: int) -> None:
        """Note a message: its stamp, its arrival, and what this machine's clock showed then."""
        reception = self.received[topic]
        reception.arrival_ns = arrival_ns
        reception.offset_ns = stamp_ns - clock_ns
        reception.arrivals_ns.append(arrival_ns)

    def review(
        self, now_ns: int, publications: Sequence[Publication], malformed: Mapping[str, int], reasons: Mapping[str, str]
    ) -> dict[str, Finding]:
        """Return what is wrong with which topic now, the gravest of each.

        Args:
            now_ns: in the time of arrivals.
            publications: who publishes what.
            malformed: number of samples that could not be read, by topic, since the beginning.
            reasons: why the last of them could not.
        """
        found = {}
        for topic in self._topics:
            fresh = malformed.get(topic, 0) - self._malformed.get(topic, 0)
            self._malformed[topic] = malformed.get(topic, 0)
            finding = self._judge(topic, now_ns, publications)
            if finding is None and fresh:
                finding = Finding(MALFORMED, f"{fresh} message(s) cannot be used: {reasons.get(topic, '')}")
            if finding is not None:
                found[topic] = finding
        return found

    def _judge(self, topic: str, now_ns: int, publications: Sequence[Publication]) -> Finding | None:
        allowed = self._topics[topic]
        here = [publication for publication in publications if publication.topic == topic]
        fitting = [publication for publication in here if publication.type_name in allowed]
        expected = " or ".join(allowed)
        if here:
            since_ns = self._here_since_ns.setdefault(topic, now_ns)
        else:
            self._here_since_ns.pop(topic, None)
            since_ns = 0
        reception = self.received[topic]
        silent_s = (now_ns - max(reception.arrival_ns, since_ns)) / NS_PER_S
        silent = silent_s > self._silent_after_s
        for other in here:
            if other.type_name not in allowed:
                also = " as well" if fitting else ""
                return Finding(
                    f"type {other.type_name}", f"is published as {other.type_name}{also}, must be {expected}"
                )
        if silent and not here:
            guess = self._guess(topic, publications)
            return Finding("no publisher", f"nobody publishes it (must be {expected}){guess}")
        if silent and self._reliable and not any(publication.reliable for publication in fitting):
            return Finding(
                "reliability", "is published best-effort, but live.reliable_inputs is set: nothing will come"
            )
        if silent:
            no_message = f"no message for {silent_s:.0f} s" if reception.arrivals_ns else "no message has come"
            seen_s = (now_ns - since_ns) / NS_PER_S
            return Finding("silent", f"has a publisher, seen for {seen_s:.0f} s, but {no_message}")
        return self._judge_clock(topic, fitting)

    def _judge_clock(self, topic: str, fitting: Sequence[Publication]) -> Finding | None:
        reception = self.received[topic]
        offset_s = reception.offset_ns / NS_PER_S
        if reception.arrivals_ns and abs(offset_s) > self._max_clock_offset_s:
            side = "ahead of" if offset_s > 0 else "behind"
            return Finding(f"clock {side}", f"stamps are {abs(offset_s):.3g} s {side} this machine's clock")
        if len(fitting) > 1:
            return Finding("publishers", f"has {len(fitting)} publishers: their messages are taken for one sensor's")
        return None

    def _guess(self, topic: str, publications: Sequence[Publication]) -> str:
        names = sorted({p.topic for p in publications if p.type_name in self._topics[topic]} - self._topics.keys())
        near = get_close_matches(topic, names, n=1, cutoff=0.0)
        return f"; did you mean {near[0]}, which is?" if near else ""
