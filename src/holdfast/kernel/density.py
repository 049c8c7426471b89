"""White noise that blocks of samples show: what lies under the lines of their spectrum, (47) in docs/math.md."""

from math import sqrt
from typing import Any

import numpy as np

from holdfast.kernel.compiling import entry, inner
from holdfast.kernel.layout import BLOCK, BUFFER, SAMPLE, records
from holdfast.kernel.samples import row_after
from holdfast.kernel.types import INT64, PAIR
from holdfast.messages import Array

LENGTH = 64  # samples of one spectrum
BINS = LENGTH // 4  # of a spectrum: above a quarter of the rate, below half of it
RANK = 3  # of the 16 squared amplitudes there, from the smallest: an engine is a few lines, and lines average out
WINDOW = np.hanning(LENGTH)
# the mean of that one for white noise with variance 1, whose squared amplitudes are distributed exponentially
EXPECTED = float((WINDOW**2).sum()) * sum(1.0 / (BINS - k) for k in range(RANK + 1))
_ANGLES = 2.0 * np.pi / LENGTH * np.outer(np.arange(LENGTH), np.arange(BINS, 2 * BINS))
COSINES, SINES = np.cos(_ANGLES), np.sin(_ANGLES)  # (LENGTH, BINS)


@inner
def density_between(buffer: Any, samples: Any, blocks: Any, start_ns: int, end_ns: int) -> tuple[float, float]:
    """Return the white noise of accelerometer and gyroscope that the samples in a time show, or those just before it.

    Only samples until the end of that time count, in blocks: the answer does not depend on when it is asked for. It is
    0 where there are none.
    """
    last = (buffer.dropped + row_after(buffer, samples, end_ns)) // LENGTH - 1
    first = min(last, (buffer.dropped + row_after(buffer, samples, start_ns - 1)) // LENGTH)
    count, force, rate = 0, 0.0, 0.0
    for number in range(first, last + 1):
        block = blocks[number % len(blocks)]
        if block.number != number + 1 and not _fill(buffer, samples, number, block):
            continue
        count += 1
        force += block.force * block.force
        rate += block.rate * block.rate
    if count == 0:
        return 0.0, 0.0
    return sqrt(force / count), sqrt(rate / count)


@inner
def _fill(buffer: Any, samples: Any, number: int, block: Any) -> bool:
    """Find what a block shows; False where the IMU was silent in it, or its samples are gone."""
    row = number * LENGTH - buffer.dropped
    if row < buffer.first:
        return False
    for k in range(row, row + LENGTH):
        if samples[k].is_gap:
            return False
    dt_s = (samples[row + LENGTH - 1].stamp_ns - samples[row].stamp_ns) * 1e-9 / (LENGTH - 1)
    force, rate, readings = 0.0, 0.0, np.empty(LENGTH)
    for channel in range(3):
        for k in range(LENGTH):
            readings[k] = samples[row + k].force[channel]
        force += _floor(readings)
        for k in range(LENGTH):
            readings[k] = samples[row + k].rate[channel]
        rate += _floor(readings)
    block.number, block.force, block.rate = number + 1, sqrt(force / 3.0 * dt_s), sqrt(rate / 3.0 * dt_s)
    return True


@inner
def _floor(readings: Array) -> float:
    """Return the variance of white noise that would explain the smallest amplitudes of a spectrum."""
    mean = readings.mean()
    real, imaginary = np.zeros(BINS), np.zeros(BINS)
    for k in range(LENGTH):
        reading = (readings[k] - mean) * WINDOW[k]
        for m in range(BINS):
            real[m] += reading * COSINES[k, m]
            imaginary[m] += reading * SINES[k, m]
    squares = np.sort(real * real + imaginary * imaginary)
    return float(squares[RANK] / EXPECTED)


# --- what Python calls: compiled here, so it comes last


@entry(PAIR, records(BUFFER), records(SAMPLE), records(BLOCK), INT64, INT64)
def find_density(buffer: Any, samples: Any, blocks: Any, start_ns: int, end_ns: int) -> tuple[float, float]:
    """Return the white noise of accelerometer and gyroscope that the samples in a time show, or those just before."""
    return density_between(buffer[0], samples, blocks, start_ns, end_ns)
