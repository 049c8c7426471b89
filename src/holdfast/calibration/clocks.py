"""Offsets of the clocks of fixes, headings and odometries, from the constants that the graph estimates."""

from collections.abc import Sequence
from math import sqrt
from statistics import median

from holdfast.calibration.constants import combined, is_off, of_name
from holdfast.calibration.estimated import Estimated, Family, Found, judged
from holdfast.calibration.evidence import Evidence
from holdfast.config.edit import Change
from holdfast.config.model import Config
from holdfast.sensors.clock import IF_RIGHT_S, with_estimated_clock
from holdfast.sensors.registry import sensors_of

FLOOR_S = 5e-4  # sigma: sampling of the IMU, filters inside of it
DIGITS = 4  # of seconds


def clocks(evidence: Sequence[Evidence], original: Config, config: Config) -> Found:
    """Return the offsets to be added to stamps, of all sensors of which they are estimated.

    Args:
        evidence: of runs under `config`.
        original: the configuration before the calibration.
        config: that of now, which may have an offset already.
    """
    estimates: list[Estimated] = []
    changes: list[Change] = []
    for name, constants in _by_sensor(config).items():
        before = original.sensors[name].time_offset_s
        prior = float(getattr(original.sensors[name], "time_offset_sigma_s", 0.0))
        path = "sensors", name, "time_offset_s"
        known = [of_name(evidence, constant) for constant in constants]
        if not all(known):
            lost = Estimated(Family.CLOCKS, path, name, "s", before, before, prior, prior, "not observable: not used")
            estimates.append(lost)
            continue
        offset_s, variance = 0.0, FLOOR_S**2
        for off, covariance in map(combined, known):
            offset_s, variance = offset_s + float(off[-1]), variance + float(covariance[-1, -1])
        early_s = median(one.early_s.get(name, 0.0) for one in evidence)
        after = config.sensors[name].time_offset_s + early_s + offset_s
        found = judged(Estimated(Family.CLOCKS, path, name, "s", before, after, sqrt(variance), prior))
        if not is_off(after - before, sqrt(variance), prior, IF_RIGHT_S):
            found = found.kept(f"as configured, to the {IF_RIGHT_S * 1e3:g} ms that filters in sensors take")
        estimates.append(found)
        if found.is_written:
            changes.append(Change(path, round(after, DIGITS)))
    return Found(estimates, changes)


def _by_sensor(config: Config) -> dict[str, list[str]]:
    """Return the constants that a sensor's offset is the sum of, of those whose clock is estimated."""
    found: dict[str, list[str]] = {}
    for name, sensor in sensors_of(config).items():
        if float(getattr(config.sensors[name], "time_offset_sigma_s", 0.0)) > 0.0:
            for prior in with_estimated_clock(sensor).parameters:
                if prior.has_clock:
                    found.setdefault(name, []).append(prior.name(name))
    return found
