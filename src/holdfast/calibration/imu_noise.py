"""White noise of the IMUs, from the Allan deviation of their readings while the machine stands."""

from collections.abc import Iterator, Sequence
from math import log

import numpy as np
from numpy.typing import NDArray

from holdfast.calibration.estimated import Estimated, Family, Found
from holdfast.calibration.evidence import Evidence, Readings
from holdfast.config.edit import Change
from holdfast.config.model import Config, StandstillConfig
from holdfast.config.sensors import InertialConfig

WINDOW_S = 4.0
AVERAGES = (1, 2, 4, 8, 16, 32, 64)  # samples that are averaged: vibration shows at the short ones, drift at the long
MAX_AVERAGE = 8  # averages in a window, at least
MIN_WINDOWS = 2
CLEAR = log(1.5)  # less than that is no reason to change a datasheet's number
PRIOR = log(3.0)  # sigma of a logarithm: how well a datasheet or a default knows the noise
KINDS = (("gyroscope_noise_density", 0, "rad/s/sqrt(Hz)"), ("accelerometer_noise_density", 3, "m/s^2/sqrt(Hz)"))


def imu_noise(evidence: Sequence[Evidence], original: Config) -> Found:
    """Return the white noise of each IMU; only one that is larger than configured is written.

    Standing, an IMU shows the least of its noise: a smaller number says nothing of how it measures while the machine
    works, and the estimator already adds what vibration shows.

    Args:
        evidence: of runs; only the readings count.
        original: the configuration.
    """
    estimates: list[Estimated] = []
    changes: list[Change] = []
    names = [original.imu_name, *([original.base_imu[0]] if original.base_imu else [])]
    for name in names:
        section = original.sensors[name]
        assert isinstance(section, InertialConfig)
        variances = [
            one
            for run in evidence
            if name in run.readings
            for one in _variances(run.readings[name], original.standstill)
        ]
        for key, first, unit in KINDS:
            before = float(getattr(section, key))
            path = "sensors", name, key
            row = Estimated(Family.IMU_NOISE, path, name, unit, before, before, before * PRIOR, before * PRIOR)
            if len(variances) < MIN_WINDOWS:
                estimates.append(row.kept(f"not observable: it stood for less than {MIN_WINDOWS * WINDOW_S:g} s"))
                continue
            after, sigma = _density(np.array(variances)[:, :, first : first + 3])
            row = Estimated(Family.IMU_NOISE, path, name, unit, before, after, sigma, before * PRIOR)
            if log(after / before) < max(CLEAR, 2.0 * sigma / after):
                more = "standing shows the least of it" if after < before else "as configured"
                row = row.kept(more)
            else:
                changes.append(Change(path, float(f"{after:.3g}")))
            estimates.append(row)
    return Found(estimates, changes)


def _variances(readings: Readings, bounds: StandstillConfig) -> Iterator[NDArray[np.float64]]:
    """Yield, for each window at standstill, the Allan variance times its averaging time (A, 6): density squared."""
    if len(readings.times_ns) < 2:
        return
    period_s = float(np.median(np.diff(readings.times_ns))) * 1e-9
    size = max(2 * MAX_AVERAGE, round(WINDOW_S / max(period_s, 1e-6)))
    allowed = np.repeat([bounds.max_angular_rate_rad_s, bounds.max_acceleration], 3)
    for k in range(0, len(readings.values) - size, size):
        window = readings.values[k : k + size]
        took_s = float(readings.times_ns[k + size - 1] - readings.times_ns[k]) * 1e-9
        if took_s < 1.2 * size * period_s and (window.std(axis=0) < allowed).all():
            yield np.array([_allan(window, m) * m * period_s for m in AVERAGES if m * MAX_AVERAGE <= size])


def _allan(values: NDArray[np.float64], m: int) -> NDArray[np.float64]:
    """Return the overlapping Allan variance (6,) of means over m samples (IEEE Std 952)."""
    sums = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    means = (sums[m:] - sums[:-m]) / m
    steps = means[m:] - means[:-m]
    return 0.5 * np.asarray((steps**2).mean(axis=0))


def _density(variances: NDArray[np.float64]) -> tuple[float, float]:
    """Return density and sigma of the worst axis, of (W, A, 3): at the averaging time at which least is added."""
    by_average = np.median(variances, axis=0)
    worst = int(by_average.min(axis=0).argmax())
    at = int(by_average[:, worst].argmin())
    squared = variances[:, at, worst]
    density = float(np.sqrt(np.median(squared)))
    spread = float(np.median(np.abs(np.sqrt(squared) - density))) * 1.4826
    return density, max(spread / np.sqrt(len(squared)), 0.03 * density)
