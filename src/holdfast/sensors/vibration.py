"""Noise that the samples of an IMU show: what lies between the lines of their spectrum, next to half the rate."""

from collections.abc import Sequence

import numpy as np

from holdfast.sensors.preintegration import Density

BLOCK = 64  # samples of one spectrum
UPPER = slice(BLOCK // 4, BLOCK // 2)  # of a spectrum: above a quarter of the rate, below half of it
RANK = 3  # of the 16 squared amplitudes there, from the smallest: an engine is a few lines, and lines average out
WINDOW = np.hanning(BLOCK)[:, None]
# the mean of that one for white noise with variance 1, whose squared amplitudes are distributed exponentially
EXPECTED = float((WINDOW**2).sum()) * sum(1.0 / (BLOCK // 4 - k) for k in range(RANK + 1))


def block_density(stamps_ns: Sequence[int], readings: Sequence[Sequence[float]]) -> Density:
    """Return the white noise under the lines of one spectrum: (47) in docs/math.md.

    Args:
        stamps_ns: of `BLOCK` samples.
        readings: (BLOCK, 6) specific force [m/s^2] and angular velocity [rad/s].
    """
    samples = np.array(readings)
    spectrum = np.abs(np.fft.rfft((samples - samples.mean(axis=0)) * WINDOW, axis=0)[UPPER]) ** 2
    variances = np.partition(spectrum, RANK, axis=0)[RANK] / EXPECTED
    dt_s = (stamps_ns[-1] - stamps_ns[0]) * 1e-9 / (len(stamps_ns) - 1)
    force, rate = variances[:3].mean() * dt_s, variances[3:].mean() * dt_s
    return Density(float(force) ** 0.5, float(rate) ** 0.5)
