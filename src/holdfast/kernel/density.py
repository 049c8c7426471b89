"""White noise that blocks of samples show: what lies under the lines of their spectrum, (47) in docs/math.md."""

from math import comb, sqrt
from typing import Any

import numpy as np

from holdfast.kernel.compiling import entry, inner
from holdfast.kernel.layout import BLOCK, BUFFER, SAMPLE, records
from holdfast.kernel.samples import row_after
from holdfast.kernel.types import INT64, PAIR
from holdfast.messages import Array

LENGTH = 64  # samples of one spectrum
BINS = LENGTH // 4  # of a spectrum: above a quarter of the rate, below half of it
RANK = 1  # of the 16 squared amplitudes there, from the smallest: an engine is a few lines, and lines average out
WINDOW = np.hanning(LENGTH)


def _expected() -> float:
    """Return the mean of that one for white noise with variance 1 on three axes, whose squared amplitudes add up.

    Their sum has a gamma distribution of shape 3; the mean of an order statistic is the integral of the probability
    that it is larger.
    """
    x = np.linspace(0.0, 40.0, 4001)
    larger = np.exp(-x) * (1.0 + x + 0.5 * x**2)
    beyond = np.sum([comb(BINS, k) * (1.0 - larger) ** k * larger ** (BINS - k) for k in range(RANK + 1)], axis=0)
    return float((WINDOW**2).sum() * (beyond[:-1] + beyond[1:]).sum() * 0.5 * (x[1] - x[0]))


EXPECTED = _expected()
_ANGLES = 2.0 * np.pi / LENGTH * np.outer(np.arange(LENGTH), np.arange(BINS, 2 * BINS))
COSINES, SINES = np.cos(_ANGLES), np.sin(_ANGLES)  # (LENGTH, BINS)


@inner
def density_between(buffer: Any, samples: Any, blocks: Any, start_ns: int, end_ns: int) -> tuple[float, float]:
    """Return the white noise of accelerometer and gyroscope that the samples in a time show, or those just before it.

    Only samples until the end of that time count, in blocks: the answer does not depend on when it is asked for. It is
    0 where there are none. Of the accelerometer it is no less than what receivers show.
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
        return buffer.sway, 0.0
    return max(buffer.sway, sqrt(force / count)), sqrt(rate / count)


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
    force, rate, readings = np.zeros(BINS), np.zeros(BINS), np.empty(LENGTH)
    for channel in range(3):
        for k in range(LENGTH):
            readings[k] = samples[row + k].force[channel]
        _add_squares(readings, force)
        for k in range(LENGTH):
            readings[k] = samples[row + k].rate[channel]
        _add_squares(readings, rate)
    block.number = number + 1
    block.force = sqrt(np.sort(force)[RANK] / EXPECTED * dt_s)
    block.rate = sqrt(np.sort(rate)[RANK] / EXPECTED * dt_s)
    return True


@inner
def _add_squares(readings: Array, squares: Array) -> None:
    """Add the squared amplitudes of one axis to those of others (BINS,)."""
    mean = readings.mean()
    real, imaginary = np.zeros(BINS), np.zeros(BINS)
    for k in range(LENGTH):
        reading = (readings[k] - mean) * WINDOW[k]
        for m in range(BINS):
            real[m] += reading * COSINES[k, m]
            imaginary[m] += reading * SINES[k, m]
    for m in range(BINS):
        squares[m] += real[m] * real[m] + imaginary[m] * imaginary[m]


# --- what Python calls: compiled here, so it comes last


@entry(PAIR, records(BUFFER), records(SAMPLE), records(BLOCK), INT64, INT64)
def find_density(buffer: Any, samples: Any, blocks: Any, start_ns: int, end_ns: int) -> tuple[float, float]:
    """Return the white noise of accelerometer and gyroscope that the samples in a time show, or those just before."""
    return density_between(buffer[0], samples, blocks, start_ns, end_ns)
