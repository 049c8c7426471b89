"""What is beside the motion of now, but as it was seconds ago, or will be: dated late or early, not wrong.

A delay of a tenth of a second is a state of the graph, linear about none; one of a second is found here, where it
explains what no mounting does, and belongs into the stamps.
"""

from collections import deque
from collections.abc import Callable, Collection, Mapping
from math import pi, tau
from typing import Any, NamedTuple

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.graph.dual_graph import DualGraph
from holdfast.messages import Array
from holdfast.sensors.sensor import Parameter

MOST_NS, COUNT = 40_000_000_000, 256  # of values that are kept
ENOUGH, ENOUGH_NS = 16, 10_000_000_000  # of these, to tell anything
EVERY_NS = 1_000_000_000  # between two looks
MOST_S, STEP_S = 3.0, 0.05  # delays that are tried, of either sign
SAME_S, SURE_NS = 0.1, 3_000_000_000  # by which a delay is the same one, and for how long it must be found
FAR_S = 0.3  # nearer ones are found by the graph
FEWER = 9.0  # times less is left of the squares
SIGMAS = 4.0  # by which values that are late are beside what is expected at least, in the mean

DateLater = Callable[[Collection[str], int], object]
"""Reads stamps of sensors as so much later [ns], those that will come."""


class Seen(NamedTuple):
    """A value, or several (k,), with the noise in all, and what is expected at the stamp."""

    stamp_ns: int
    measured: float | Array
    sigma: float
    expected: float | Array


class FarDelay:
    """The newest values of one sensor, beside what is expected but for a constant.

    Args:
        least: by which they are beside it at least where they are late, in the mean.
        is_angle: whether they are angles [rad], and the same with a full turn.
        left: so much what is expected may be wrong by; as much as `least` if it is not given.
    """

    def __init__(self, least: float, *, is_angle: bool, left: float | None = None) -> None:
        self._least, self._is_angle, self._left = least, is_angle, least if left is None else left
        self.clear()

    def clear(self) -> None:
        """Forget them: their stamps mean something else now."""
        self._seen: deque[Seen] = deque(maxlen=COUNT)
        self._looked_ns = 0
        self._suspected: tuple[float, int] | None = None  # a delay [s], and when it was found first

    def note(self, seen: Seen) -> None:
        """Take in a value, whether it was used or not."""
        stamp_ns = seen.stamp_ns
        if self._seen and stamp_ns <= self._seen[-1].stamp_ns:
            return
        thin_ns = MOST_NS // COUNT
        if len(self._seen) > 1 and stamp_ns - self._seen[-2].stamp_ns < thin_ns:
            self._seen.pop()
        measured, expected = np.atleast_1d(seen.measured), np.atleast_1d(seen.expected)
        self._seen.append(seen._replace(measured=measured, expected=expected))
        while stamp_ns - self._seen[0].stamp_ns > MOST_NS:
            self._seen.popleft()

    def delay_s(self) -> float | None:
        """Return by how much stamps are late [s], if they are far off, that explains the values, and goes on so."""
        if not self._seen or self._seen[-1].stamp_ns - self._looked_ns < EVERY_NS:
            return None
        self._looked_ns = self._seen[-1].stamp_ns
        found_s = self._found_s()
        if found_s is None or self._suspected is None or abs(found_s - self._suspected[0]) > SAME_S:
            self._suspected = None if found_s is None else (found_s, self._looked_ns)
        is_sure = self._suspected is not None and self._looked_ns - self._suspected[1] >= SURE_NS
        return found_s if is_sure else None

    def _found_s(self) -> float | None:
        if len(self._seen) < ENOUGH or self._looked_ns - self._seen[0].stamp_ns < ENOUGH_NS:
            return None
        stamps_ns, measured, sigmas, expected = (np.array(one) for one in zip(*self._seen, strict=True))
        times_s = (stamps_ns - stamps_ns[0]) * 1e-9
        expected = np.unwrap(expected, axis=0) if self._is_angle else expected
        is_judged = (times_s > MOST_S) & (times_s < times_s[-1] - MOST_S)

        def left(delay_s: float) -> float:
            at_s = times_s[is_judged] - delay_s
            moved = np.column_stack([np.interp(at_s, times_s, column) for column in expected.T])
            return self._spread(measured[is_judged] - moved)

        noise = (SIGMAS * float(sigmas.mean())) ** 2
        if is_judged.sum() < ENOUGH or (as_stamped := left(0.0)) < self._least**2 + noise:
            return None
        delays_s = np.arange(-MOST_S, MOST_S + 0.5 * STEP_S, STEP_S)
        squares = np.array([left(one) for one in delays_s])
        best = int(squares.argmin())
        fits = squares[best] < min(self._left**2 + noise, as_stamped / FEWER)
        if not fits or abs(delays_s[best]) < FAR_S or best in (0, len(delays_s) - 1):
            return None
        before, least, after = squares[best - 1 : best + 2]
        return float(delays_s[best] + 0.5 * STEP_S * (before - after) / (before - 2.0 * least + after))

    def _spread(self, beside: Array) -> float:
        """Return the mean square of values (n, k) about their mean."""
        return float(((beside - beside[0] + pi) % tau if self._is_angle else beside).var(axis=0).sum())


class Delays:
    """Looks for delays of some sensors that are too long for a state of a graph, and dates anew what those say.

    Args:
        sensors: the models, by name.
        clocks: what a graph estimates of their clocks, by name, where it does.
        new: makes what compares the values of one.
        log: where events go.
        date_later: reads stamps of sensors as so much later [ns], those that will come.
    """

    def __init__(
        self,
        sensors: Mapping[str, Any],
        clocks: Mapping[str, Parameter],
        new: Callable[[], FarDelay],
        log: EventLog,
        date_later: DateLater,
    ) -> None:
        self._sensors, self._clocks = sensors, clocks
        self._late = {name: new() for name in sensors}
        self._log, self._date_later = log, date_later

    def __contains__(self, name: str) -> bool:
        return name in self._late

    def look(self, graph: DualGraph, name: str, seen: Seen, *, is_refused: bool) -> None:
        """Take in a value of a sensor; where such are in doubt look whether it is late."""
        late = self._late[name]
        late.note(seen)
        if not (is_refused or self._is_far(graph, name)) or (delay_s := late.delay_s()) is None:
            return
        self._log.report(EventKind.CALIBRATION, seen.stamp_ns, name, told(delay_s))
        self._date_later([name], -round(delay_s * 1e9))
        late.clear()
        for parameter in self._sensors[name].parameters:  # what was believed of it until now
            if not parameter.shared:
                graph.begin_parameter_anew(parameter.name(name), parameter)

    def _is_far(self, graph: DualGraph, name: str) -> bool:
        """Whether a graph believes in an offset that is too long for it."""
        if (clock := self._clocks.get(name)) is None:
            return False
        return abs(float(graph.main.parameters.belief(clock.name(name), clock)[0][0])) > FAR_S


def told(delay_s: float) -> str:
    """Return in words that stamps are late by so much, and what to do about it."""
    sign = "late" if delay_s > 0.0 else "early"
    return f"its stamps are {abs(delay_s):.2f} s {sign} beside the motion: add {-delay_s:.2f} to time_offset_s"
