"""Antennas whose positions come by each other's name: somebody has exchanged cables, topics or lever arms.

The estimate tells at once, if it was right before: what it expects of either antenna is where the other is. One that
has begun with the wrong names is turned by half a circle: there the batch of a start tells.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.integrity.learnt_snapshot import NAMES_ARE_RIGHT, LearntNames
from holdfast.measured_fields import NEVER_NS
from holdfast.sensors.heading import HeadingModel
from holdfast.sensors.sensor import Measurement, Position, Sensor

ENOUGH, WITHIN_NS = 3, 5_000_000_000  # positions of either, and in which time, that are where the other is expected

Pair = tuple[str, str]


class Exchange(NamedTuple):
    """Two antennas whose positions come by each other's name.

    Attributes:
        pair: by name.
        since_ns: the first stamp at which they were found to.
        headings: from one to the other, that are reversed.
    """

    pair: Pair
    since_ns: int = NEVER_NS
    headings: frozenset[str] = frozenset()


class Exchanges:
    """By which names positions come, from one start over to the next.

    Args:
        known: what was found before.
    """

    def __init__(self, known: LearntNames = NAMES_ARE_RIGHT) -> None:
        self._really = dict(known.antennas)
        self._reversed = frozenset(known.reversed)  # headings

    def learnt(self) -> LearntNames:
        """Return what is known now."""
        antennas = {said: really for said, really in self._really.items() if said != really}
        return LearntNames(antennas=antennas, reversed=tuple(sorted(self._reversed)))

    def named(self, measurement: Measurement | Outcome) -> Measurement | Outcome:
        """Return a measurement by the name of the antenna that it is of."""
        if isinstance(measurement, Position) and measurement.sensor in self._really:
            return replace(measurement, sensor=self._really[measurement.sensor])
        return measurement

    def believed(self, sensors: Mapping[str, Sensor]) -> dict[str, Sensor]:
        """Return the models, with the axes of headings from one antenna to another turned as far as they are."""
        return {
            name: one.reversed() if name in self._reversed and isinstance(one, HeadingModel) else one
            for name, one in sensors.items()
        }

    def add(self, exchange: Exchange, now_ns: int, log: EventLog) -> None:
        """Know that from now on two antennas' positions come by each other's name, or by their own again."""
        pair = exchange.pair
        self._reversed ^= exchange.headings
        one, other = (next((said for said, is_of in self._really.items() if is_of == name), name) for name in pair)
        self._really[one], self._really[other] = pair[1], pair[0]
        if self._really[one] == one:
            reason = "each is where the file says again"
        else:
            reason = "each is where the file has the other: their topics, cables or translations are exchanged"
        log.report(EventKind.LEVER_ARM, now_ns, ", ".join(sorted(pair)), reason)


class ExchangeTest:
    """Compares positions with what an estimate expects of other antennas: (91) in docs/math.md."""

    def __init__(self) -> None:
        self._fitted: dict[Pair, list[int]] = {}  # stamps of positions of one antenna where another is expected

    def note(self, position: Position, others: Collection[str], *, is_expected: bool) -> list[Exchange]:
        """Take in a position, in the order of stamps; return whose it may be, where that has become clear.

        Fixes that walk come by the place of another antenna, too, but do not exchange theirs with it.

        Args:
            position: of an antenna.
            others: antennas that are expected where it is.
            is_expected: it is where its own antenna is expected.
        """
        name, found = position.sensor, list[Exchange]()
        if is_expected:
            self._fitted = {pair: stamps for pair, stamps in self._fitted.items() if name not in pair}
            return found
        for other in others:
            here, there = (self._fitted.setdefault(pair, []) for pair in ((name, other), (other, name)))
            here.append(position.stamp_ns)
            for stamps in here, there:
                stamps[:] = [one for one in stamps[-ENOUGH:] if position.stamp_ns - one <= WITHIN_NS]
            if min(len(here), len(there)) == ENOUGH:
                found.append(Exchange((min(name, other), max(name, other)), min(*here, *there)))
                here.clear()
                there.clear()
        return found
