"""Antennas whose positions come by each other's name: somebody has exchanged cables, topics or lever arms.

The estimate tells at once, if it was right before: what it expects of either antenna is where the other is. One that
has begun with the wrong names is turned by half a circle: there the batch of a start tells.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from holdfast.event_log import EventLog
from holdfast.integrity.learnt_snapshot import NAMES_ARE_RIGHT, LearntNames
from holdfast.integrity.lever_arms import PAIRED_NS
from holdfast.integrity.receiver import Prediction
from holdfast.sensors.heading import HeadingModel
from holdfast.sensors.sensor import Measurement, Position, Sensor
from holdfast.state import EventKind, Outcome

IN_A_ROW = 3  # times at which both are where the other is expected

Pair = tuple[str, str]


class Exchange(NamedTuple):
    """Two antennas whose positions come by each other's name, and headings from one to the other that are reversed."""

    pair: Pair
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


class Exchanged(NamedTuple):
    """Two antennas that are each where the other is expected, and the first time at which they were."""

    pair: Pair
    since_ns: int


class ExchangeTest:
    """Compares positions of one time with what an estimate expects of each other: (91) in docs/math.md."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[Position, Prediction]] = {}
        self._in_a_row: Counter[Pair] = Counter()
        self._since_ns: dict[Pair, int] = {}

    def note(self, position: Position, prediction: Prediction, limit: float) -> list[Exchanged]:
        """Take in a position, in the order of stamps; return whose it may be, where that has become clear.

        Args:
            position: of an antenna.
            prediction: what the estimate expects of it.
            limit: on the NIS of a position that is expected.
        """
        found = []
        self._last[position.sensor] = position, prediction
        for other, expected in self._last.values():
            if other.sensor == position.sensor or abs(other.stamp_ns - position.stamp_ns) > PAIRED_NS:
                continue
            pair = min(position.sensor, other.sensor), max(position.sensor, other.sensor)
            between = other.p_W_P - position.p_W_P
            as_named = prediction.nis, expected.nis
            here = replace(prediction, innovation=prediction.innovation + between, of_position=expected.of_position)
            there = replace(expected, innovation=expected.innovation - between, of_position=prediction.of_position)
            if min(as_named) <= limit or max(here.nis, there.nis) > limit:
                self._in_a_row.pop(pair, None)
                continue
            self._in_a_row[pair] += 1
            if self._in_a_row[pair] == 1:
                self._since_ns[pair] = min(position.stamp_ns, other.stamp_ns)
            if self._in_a_row[pair] == IN_A_ROW:
                del self._in_a_row[pair]
                found.append(Exchanged(pair, self._since_ns[pair]))
        return found
