"""The buffer of the IMU's samples: taking one in, finding drop-outs, cutting it at will."""

from typing import Any

from holdfast.kernel.compiling import entry, inner
from holdfast.kernel.layout import BUFFER, SAMPLE, STEP, records
from holdfast.kernel.search import first_after
from holdfast.kernel.types import INT64, READING, TRIPLE, UNTIL, VOID

SUSPECT_LINE = 3  # so many steps on one line happen by chance once in a long while
FROZEN_FACTOR = 10  # a reading that does not change at all for this many gap lengths is a dead sensor
PERIOD_WINDOW, EXCEPTIONS = 64, 2  # samples that tell how often they come; longer intervals than the others
MOST_GAP_NS = 250_000_000  # that bursts or losses explain
LINE_TOLERANCE = 1e-3  # of the change per sample; six channels of a living sensor never agree that well
KEPT_ROWS, KEPT_NS = 1000, 10_000_000_000  # so many samples, or so long, are dropped at once
DELAY_WINDOW = 64  # samples over whose shortest delay the next are judged; twice as many at most

STEPPED, IS_LINE = 1, 2  # flags of what a sample brought: a step from the one before, a line that is certain now

Samples, Buffer = records(SAMPLE), records(BUFFER)


@inner
def is_usual(buffer: Any, samples: Any, stamp_ns: int, r: tuple[float, ...]) -> bool:
    """Whether a sample follows the one before within the usual time and in range, and there is a row for it."""
    f, w = buffer.accelerometer_range, buffer.gyroscope_range
    # NaN and infinity fail every comparison
    in_range = -f <= r[0] <= f and -f <= r[1] <= f and -f <= r[2] <= f
    in_range = in_range and -w <= r[3] <= w and -w <= r[4] <= w and -w <= r[5] <= w
    follows = buffer.first < buffer.end < len(samples) and 0 < stamp_ns - buffer.newest_ns <= buffer.max_gap_ns
    return in_range and follows and buffer.is_suspicious == 0


@inner
def append(buffer: Any, samples: Any, stamp_ns: int, arrival_ns: int, reading: tuple[float, ...]) -> int:
    """Append a checked sample for which there is a row; return what it brought."""
    _learn_delay(buffer, arrival_ns - stamp_ns)
    row, dt_ns = buffer.end, stamp_ns - buffer.newest_ns
    sample, has_step, is_gap = samples[row], False, 0
    if buffer.first < row:
        is_gap = int(dt_ns > buffer.max_gap_ns)
        has_step = not is_gap
        _learn_period(buffer, dt_ns)
    sample.stamp_ns, sample.is_gap = stamp_ns, is_gap
    for k in range(3):
        sample.force[k], sample.rate[k] = reading[k], reading[3 + k]
    buffer.before_ns, buffer.newest_ns = buffer.newest_ns, stamp_ns
    buffer.arrival_ns, buffer.is_suspicious = arrival_ns, 0
    buffer.gaps += is_gap
    buffer.end = row + 1
    if has_step and row - buffer.first >= 2:
        return _follow_line(buffer, samples, row)
    buffer.line_start = row
    return STEPPED * has_step


@inner
def _learn_delay(buffer: Any, delay_ns: int) -> None:
    if buffer.delays % DELAY_WINDOW == 0:
        buffer.older_delay_ns = buffer.delay_ns if buffer.delays else delay_ns
        buffer.delay_ns = delay_ns
    elif delay_ns < buffer.delay_ns:
        buffer.delay_ns = delay_ns
    buffer.delays += 1


@inner
def _learn_period(buffer: Any, dt_ns: int) -> None:
    """Keep the periods sorted, and take 2.5 times the usual one where that is more than the configured gap.

    Usual is their median and, where samples come in bursts or many are lost, the longest but for a few exceptions.
    """
    periods, at = buffer.periods_ns, buffer.periods
    while at > 0 and periods[at - 1] > dt_ns:
        periods[at] = periods[at - 1]
        at -= 1
    periods[at] = dt_ns
    buffer.periods += 1
    if buffer.periods == PERIOD_WINDOW:
        median_ns = 0.5 * (periods[PERIOD_WINDOW // 2 - 1] + periods[PERIOD_WINDOW // 2])
        often_ns = min(round(2.5 * periods[PERIOD_WINDOW - 1 - EXCEPTIONS]), MOST_GAP_NS)
        buffer.max_gap_ns = max(buffer.least_gap_ns, round(2.5 * median_ns), often_ns)
        buffer.periods = 0


@inner
def _follow_line(buffer: Any, samples: Any, last: int) -> int:
    """Follow the run of samples that lie on one line in all six channels, and mark it as a gap once it is certain.

    Returns:
        What the newest brings, in flags: nothing if it is on a line that was certain before.
    """
    before, middle, newest = samples[last - 2], samples[last - 1], samples[last]
    if _bends(before, middle, newest, 1.0):
        first_ns, second_ns = middle.stamp_ns - before.stamp_ns, newest.stamp_ns - middle.stamp_ns
        if first_ns == second_ns or _bends(before, middle, newest, second_ns / first_ns):
            buffer.line_start = last - 1  # on a line neither by index nor by time, whichever a logger goes by
            return STEPPED
    start = buffer.line_start
    needed_ns, is_frozen = buffer.max_gap_ns, True
    for k in range(3):
        is_frozen &= newest.force[k] == samples[start].force[k] and newest.rate[k] == samples[start].rate[k]
    if is_frozen:
        needed_ns *= FROZEN_FACTOR
    if last - start < SUSPECT_LINE or newest.stamp_ns - samples[start].stamp_ns <= needed_ns:
        return STEPPED
    is_new = not middle.is_gap
    row = last
    while row > start and not samples[row].is_gap:
        samples[row].is_gap = 1
        buffer.gaps += 1
        row -= 1
    return IS_LINE if is_new else 0


@inner
def _bends(before: Any, middle: Any, last: Any, ratio: float) -> bool:
    """Whether three samples do not lie on a line; `ratio` is the second interval over the first (1: by index)."""
    most_force, most_rate = 0.0, 0.0
    for k in range(3):
        most_force = max(most_force, abs(last.force[k] - middle.force[k]))
        most_rate = max(most_rate, abs(last.rate[k] - middle.rate[k]))
    for k in range(3):
        force = last.force[k] - middle.force[k] - ratio * (middle.force[k] - before.force[k])
        rate = last.rate[k] - middle.rate[k] - ratio * (middle.rate[k] - before.rate[k])
        if abs(force) > LINE_TOLERANCE * most_force + 1e-12 or abs(rate) > LINE_TOLERANCE * most_rate + 1e-12:
            return True
    return False


@inner
def row_after(buffer: Any, samples: Any, stamp_ns: int) -> int:
    """Return the first row that is later than a time."""
    return first_after(samples, buffer.first, buffer.end, stamp_ns)


@inner
def forget(buffer: Any, samples: Any, stamp_ns: int) -> None:
    """Drop samples that no interval after a time needs, many at once."""
    first, row = buffer.first, row_after(buffer, samples, stamp_ns) - 1
    if row - first > KEPT_ROWS or (row > first and samples[row].stamp_ns - samples[first].stamp_ns > KEPT_NS):
        for k in range(first, row):
            buffer.gaps -= samples[k].is_gap
        buffer.first, buffer.line_start = row, max(row, buffer.line_start)


@inner
def piece_from(buffer: Any, samples: Any, at_ns: int, end_ns: int) -> tuple[int, bool]:
    """Return until when, `end_ns` at most, the IMU either measured throughout or was silent throughout, and which."""
    row = row_after(buffer, samples, at_ns)
    is_gap = row in (buffer.first, buffer.end) or samples[row].is_gap != 0
    while row < buffer.end and (row == buffer.first or samples[row].is_gap != 0) == is_gap:
        at_ns = min(samples[row].stamp_ns, end_ns)
        if at_ns == end_ns:
            return end_ns, is_gap
        row += 1
    return (end_ns if is_gap and row == buffer.end else at_ns), is_gap


@inner
def cut(buffer: Any, samples: Any, row: int, at_ns: int, until_ns: int, step: Any) -> None:
    """Let a `STEP` be what lies between two times within the interval that ends at a row: (3)."""
    step.dt_s = (until_ns - at_ns) * 1e-9
    if row == buffer.end:  # a node on the grid may lie a little past the newest sample
        before = after = samples[row - 1]
        middle = 0.0
    else:
        before, after = samples[row - 1], samples[row]
        whole_ns = after.stamp_ns - before.stamp_ns
        middle = 0.5 * ((at_ns - before.stamp_ns) + (until_ns - before.stamp_ns)) / whole_ns
    for k in range(3):
        step.force[k] = (1.0 - middle) * before.force[k] + middle * after.force[k]
        step.rate[k] = (1.0 - middle) * before.rate[k] + middle * after.rate[k]


@inner
def rate_at(buffer: Any, samples: Any, stamp_ns: int) -> tuple[float, float, float]:
    """Return the reading of the gyroscope at a time [rad/s]: interpolated, or the last one before it."""
    row = row_after(buffer, samples, stamp_ns)
    if row == buffer.end or (row > buffer.first and samples[row].is_gap):
        rate = samples[row - 1].rate
        return rate[0], rate[1], rate[2]
    if row == buffer.first:
        rate = samples[row].rate
        return rate[0], rate[1], rate[2]
    before, after = samples[row - 1], samples[row]
    s = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    u, v = before.rate, after.rate
    return (1.0 - s) * u[0] + s * v[0], (1.0 - s) * u[1] + s * v[1], (1.0 - s) * u[2] + s * v[2]


# --- what Python calls: compiled here, so it comes last


@entry(INT64, Buffer, Samples, INT64, INT64, READING)
def take_in(buffer: Any, samples: Any, stamp_ns: int, arrival_ns: int, reading: tuple[float, ...]) -> int:
    """Append a checked sample for which there is a row; return what it brought, in flags."""
    return append(buffer[0], samples, stamp_ns, arrival_ns, reading)


@entry(INT64, Buffer, Samples, INT64)
def find_row_after(buffer: Any, samples: Any, stamp_ns: int) -> int:
    """Return the first row that is later than a time."""
    return row_after(buffer[0], samples, stamp_ns)


@entry(VOID, Buffer, Samples, INT64)
def forget_before(buffer: Any, samples: Any, stamp_ns: int) -> None:
    """Drop samples that no interval after a time needs, many at once."""
    forget(buffer[0], samples, stamp_ns)


@entry(UNTIL, Buffer, Samples, INT64, INT64)
def find_piece(buffer: Any, samples: Any, at_ns: int, end_ns: int) -> tuple[int, bool]:
    """Return until when, `end_ns` at most, the IMU either measured throughout or was silent throughout, and which."""
    return piece_from(buffer[0], samples, at_ns, end_ns)


@entry(INT64, Buffer, Samples, INT64, INT64, records(STEP))
def fill_steps(buffer: Any, samples: Any, start_ns: int, end_ns: int, steps: Any) -> int:
    """Fill `steps` with those that make up a stretch without a gap; return how many there are."""
    held, at_ns, count = buffer[0], start_ns, 0
    row = row_after(held, samples, start_ns)
    while at_ns < end_ns:
        until_ns = end_ns if row == held.end else min(samples[row].stamp_ns, end_ns)
        cut(held, samples, row, at_ns, until_ns, steps[count])
        at_ns, row, count = until_ns, row + 1, count + 1
    return count


@entry(TRIPLE, Buffer, Samples, INT64)
def find_rate(buffer: Any, samples: Any, stamp_ns: int) -> tuple[float, float, float]:
    """Return the reading of the gyroscope at a time [rad/s]: interpolated, or the last one before it."""
    return rate_at(buffer[0], samples, stamp_ns)
