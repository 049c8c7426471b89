"""Receivers of GNSS measure at even times: stamps that are given when their messages arrive are put where they belong.

A driver that stamps what a receiver says when it arrives adds the delay of the line, which is another one each time: at
10 m/s ten milliseconds are a decimetre beside claims of a centimetre. What all its delays have in common remains; that
is a clock that is off, and is estimated as one.
"""

from collections import deque
from dataclasses import replace
from math import sqrt
from statistics import median

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.messages import Array, GnssFix, GnssVelocity, Heading, Message

MEMORY, ENOUGH = 256, 12  # stamps
LEAST_S = 0.5e-3  # sigma of what is jitter: stamps in whole milliseconds are none
MOST_PERIODS = 1.0 / 6.0  # of a sigma: more, and nobody knows to which epoch a stamp belongs
OF_MEDIAN = 1.4826  # sigma of a normal distribution whose absolute values have a median of 1
FAR_SIGMA, OUTLIERS = 6.0, 3  # so many in a row that far off begin anew
CLIPPED_SIGMA = 3.0
ON_LINE_SIGMA = 2.0  # beside the line by no more than neighbours beside each other
RATHER_SIGMA = 4.0  # a period is a whole fraction or multiple of a second that is so near, and no other
CLOCK_RATIO = 50e-6  # by which the seconds of two clocks differ
RIGHT = 1.5  # times the square of what positions scatter by at even times, and they are better at the stamps given
ENOUGH_SQUARES = 12


class EvenStamps:
    """The even stamps of all messages of receivers; of other sensors nobody knows when they measure: (95).

    Args:
        log: where is told whose stamps jitter.
    """

    def __init__(self, log: EventLog) -> None:
        self._log = log
        self._grids: dict[str, _Grid] = {}
        self._known: dict[int, tuple[int, _Grid]] = {}  # what one receiver says at once stays together
        self._squares: dict[str, deque[tuple[float, float]]] = {}
        self._right: set[str] = set()  # receivers whose stamps are right as they are given
        self._moved_ns: dict[str, int] = {}

    def read(self, message: Message) -> Message:
        """Return a message, in the order of arrival, with its even stamp; the same one where there is none."""
        if not isinstance(message, GnssFix | GnssVelocity | Heading) or message.sensor in self._right:
            return message
        given_ns = message.stamp_ns
        if given_ns in self._known:
            even_ns, self._grids[message.sensor] = self._known[given_ns]
        else:
            grid = self._grids.setdefault(message.sensor, _Grid())
            even_ns = grid.even(given_ns)
            self._known[given_ns] = even_ns, grid
            if len(self._known) > MEMORY:
                del self._known[next(iter(self._known))]
            if grid.is_news():
                jitter = f"its stamps jitter by {grid.sigma_s * 1e3:.1f} ms: taken as every {grid.period_s:.4g} s"
                self._log.report(EventKind.NOISE, given_ns, message.sensor, jitter)
        self._moved_ns[message.sensor] = given_ns - even_ns
        return message if even_ns == given_ns else replace(message, stamp_ns=even_ns)

    def moved_ns(self, sensor: str) -> int:
        """Return by how much the given stamp is later than the even one that `read` has just made of it."""
        return 0 if sensor in self._right else self._moved_ns.get(sensor, 0)

    def judge(self, sensor: str, at_given: float, at_even: float, stamp_ns: int) -> None:
        """Take in the squares of what positions scatter by at either stamps: those that scatter less are right."""
        squares = self._squares.setdefault(sensor, deque(maxlen=2 * ENOUGH_SQUARES))
        squares.append((at_given, at_even))
        if len(squares) < ENOUGH_SQUARES or sensor in self._right:
            return
        given, even = (median(column) for column in zip(*squares, strict=True))
        if even + 1.0 > RIGHT * (given + 1.0):  # less than they claim tells nothing
            self._right.add(sensor)
            self._log.report(EventKind.NOISE, stamp_ns, sensor, "its uneven stamps are right: used as they are")


class _Grid:
    """The even times at which one receiver measures.

    Attributes:
        period_s: between them.
        sigma_s: of the stamps beside them; 0 while they are even, or nothing is known.
    """

    def __init__(self) -> None:
        self._stamps, self._numbers = deque[int](maxlen=MEMORY), deque[int](maxlen=MEMORY)
        self._even_ns = 0  # of the newest number
        self._since_fit = 0  # stamps
        self._outliers = 0
        self._is_told = False
        self.period_s = self.sigma_s = 0.0

    def is_news(self) -> bool:
        """Whether stamps jitter of which this has not been asked yet."""
        is_news = self.sigma_s > 0.0 and not self._is_told
        self._is_told |= is_news
        return is_news

    def even(self, stamp_ns: int) -> int:
        """Return the even time of a stamp, which is where it is while nothing better is known."""
        if self.sigma_s:
            return self._go_on(stamp_ns)
        if self._stamps and stamp_ns <= self._stamps[-1]:
            return stamp_ns
        self._stamps.append(stamp_ns)
        if not self._is_due():
            return stamp_ns
        steps = np.diff(np.array(self._stamps)) * 1e-9
        counts = np.maximum(1, np.round(steps / np.median(steps)).astype(int))
        self._numbers = deque([0, *np.cumsum(counts).tolist()], maxlen=MEMORY)
        self._fit()
        return self._even_ns if self.sigma_s else stamp_ns

    def _go_on(self, stamp_ns: int) -> int:
        """Return the even time that is nearest to a stamp; far from all of them are others after a while."""
        period_ns = self.period_s * 1e9
        ahead = round((stamp_ns - self._even_ns) / period_ns)
        nearest_ns = self._even_ns + round(ahead * period_ns)
        if ahead <= 0:  # late, or the one before was
            return nearest_ns if ahead < 0 else stamp_ns
        self._outliers = self._outliers + 1 if abs(stamp_ns - nearest_ns) > FAR_SIGMA * self.sigma_s * 1e9 else 0
        if self._outliers >= OUTLIERS:
            self._stamps.clear()
            self._outliers, self.sigma_s = 0, 0.0
            return stamp_ns
        self._stamps.append(stamp_ns)
        self._numbers.append(self._numbers[-1] + ahead)
        self._even_ns = nearest_ns
        if self._is_due():
            self._fit()
        return self._even_ns

    def _is_due(self) -> bool:
        """Whether enough stamps have come since the last fit to make another one of them."""
        self._since_fit += 1
        return len(self._stamps) >= ENOUGH and self._since_fit * ENOUGH >= len(self._stamps)

    def _fit(self) -> None:
        """Find jitter, period and the newest even time."""
        self._since_fit = 0
        times = (np.array(self._stamps) - self._stamps[-1]) * 1e-9
        numbers = np.array(self._numbers, dtype=float) - self._numbers[-1]
        steps, counts = np.diff(times), np.diff(numbers)
        period_s = float(np.median(steps / counts))
        # neighbours only: a clock that steps is no jitter
        sigma_s = OF_MEDIAN * float(np.median(np.abs(steps - counts * period_s))) / sqrt(2.0)
        if not LEAST_S < sigma_s < MOST_PERIODS * period_s:
            self.sigma_s = 0.0
            return
        newest_s, self.period_s = _line(numbers, times, sigma_s)
        beside_s = OF_MEDIAN * float(np.median(np.abs(times - newest_s - self.period_s * numbers)))
        self.sigma_s = sigma_s if beside_s < ON_LINE_SIGMA * sigma_s else 0.0  # several to an epoch, a clock that walks
        self._even_ns = self._stamps[-1] + round(newest_s * 1e9)


def _line(numbers: Array, times: Array, sigma_s: float) -> tuple[float, float]:
    """Return the even time of number 0 [s] and the period [s]; both arguments are (N,), the second given times [s].

    Receivers measure so many times a second, or every so many seconds: such a period is known but for the clock.
    """
    half = len(numbers) // 2
    rough_s = np.median((times[half:] - times[: len(times) - half]) / (numbers[half:] - numbers[: len(times) - half]))
    residuals = times - rough_s * numbers
    residuals -= np.median(residuals)
    clipped = times - residuals + np.clip(residuals, -CLIPPED_SIGMA * sigma_s, CLIPPED_SIGMA * sigma_s)
    A = np.stack([np.ones(len(numbers)), numbers], axis=1)
    information = A.T @ A
    start_s, period_s = np.linalg.solve(information, A.T @ clipped)
    near_s = RATHER_SIGMA * sigma_s * sqrt(np.linalg.inv(information)[1, 1]) + CLOCK_RATIO * period_s
    whole = max(1, round(period_s)) if period_s > 0.7 else 1.0 / round(1.0 / period_s)
    neighbour = whole + 1.0 if whole >= 1.0 else 1.0 / (1.0 / whole + 1.0)
    if abs(period_s - whole) < near_s < 0.5 * abs(whole - neighbour):
        weight = (sigma_s / (CLOCK_RATIO * whole)) ** 2
        information[1, 1] += weight
        start_s, period_s = np.linalg.solve(information, A.T @ clipped + [0.0, weight * whole])
    return float(start_s), float(period_s)
