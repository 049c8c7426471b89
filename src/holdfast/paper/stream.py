"""Streams of messages between a recording and a system: delayed, with a wrong clock, or watched."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from heapq import heappop, heappush

from holdfast.config.model import Config
from holdfast.events import Outcome
from holdfast.messages import Message
from holdfast.paper.study import Disturbance
from holdfast.replay.published import Localiser

RECEIVER = {"gnss", "heading"}
SECOND_NS = 1_000_000_000


def disturbed(messages: Iterable[Message], disturbance: Disturbance | None, config: Config) -> Iterator[Message]:
    """Yield messages in the order of their new arrivals."""
    if disturbance is None:
        yield from messages
        return
    kinds = RECEIVER if disturbance.kind == "gnss" else {disturbance.kind}
    sensors = _of_kinds(config, kinds)
    delay_ns, clock_ns = round(disturbance.delay_s * 1e9), round(disturbance.clock_s * 1e9)
    late: list[tuple[int, int, Message]] = []
    for count, message in enumerate(messages):
        while late and late[0][0] <= message.arrival_ns:
            yield heappop(late)[2]
        if message.sensor in sensors:
            arrival_ns = message.arrival_ns + delay_ns
            moved = message.of(message.stamp_ns + clock_ns, arrival_ns, message.sensor, message.values())
            heappush(late, (arrival_ns, count, moved))
        else:
            yield message
    while late:
        yield heappop(late)[2]


class OutcomeLog:
    """The outcomes of the measurements of each sensor, second by second; `receivers` are antennas and headings."""

    def __init__(self, localiser: Localiser) -> None:
        self._localiser = localiser
        self.receivers = _of_kinds(localiser.config, RECEIVER)
        self._next_ns = 0
        self._before: Counter[tuple[str, Outcome]] = Counter()
        self.rows: list[tuple[int, dict[tuple[str, Outcome], int]]] = []

    def watch(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield the messages; after each second note the counts of that second."""
        for message in messages:
            yield message
            if message.arrival_ns >= self._next_ns:
                self._note(message.arrival_ns)

    def _note(self, now_ns: int) -> None:
        counts = self._localiser.counts
        changed = {key: count - self._before[key] for key, count in counts.items() if count != self._before[key]}
        self.rows.append((now_ns, changed))
        self._before = Counter(counts)
        self._next_ns = now_ns + SECOND_NS


def _of_kinds(config: Config, kinds: Collection[str]) -> set[str]:
    return {name for name, sensor in config.sensors.items() if sensor.kind in kinds}
