"""Offsets of the clocks of fixes, headings and odometries, from the constants that the graph estimates."""

from collections.abc import Sequence
from math import hypot
from statistics import median

from holdfast.calibration.constants import combined, is_off, of_name
from holdfast.calibration.estimated import Estimated, Family, Found, judged
from holdfast.calibration.evidence import Evidence
from holdfast.config.model import Config
from holdfast.sensors.clock import DELAY_S, IF_RIGHT_S, with_estimated_clock
from holdfast.sensors.constants import Constant
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
    for name, constants in _by_sensor(config).items():
        before = original.sensors[name].time_offset_s
        prior = float(getattr(original.sensors[name], "time_offset_sigma_s", 0.0))
        path = "sensors", name, "time_offset_s"
        known = [of_name(evidence, constant) for constant in constants]
        if not all(known):
            lost = Estimated(Family.CLOCKS, path, name, "s", before, before, prior, prior, "not observable: not used")
            estimates.append(lost)
            continue
        offset_s, sigma_s = _offset(known)
        early_s = median(one.early_s.get(name, 0.0) for one in evidence)
        after = config.sensors[name].time_offset_s + early_s + offset_s
        found = judged(Estimated(Family.CLOCKS, path, name, "s", before, after, sigma_s, prior))
        if not is_off(after - before, sigma_s, prior, IF_RIGHT_S):
            found = found.kept(f"as configured, to the {IF_RIGHT_S * 1e3:g} ms that filters in sensors take")
        estimates.append(found)
    return Found.of(estimates, DIGITS)


def _offset(known: Sequence[Sequence[Constant]]) -> tuple[float, float]:
    """Return a sensor's offset and its sigma [s]: that of its clock, the last, and a delay unless it is none."""
    found = [(float(off[-1]), float(covariance[-1, -1]) ** 0.5) for off, covariance in map(combined, known)]
    parts = [found[-1], *(one for one in found[:-1] if is_off(*one, DELAY_S, IF_RIGHT_S))]
    return sum(off_s for off_s, _ in parts), hypot(FLOOR_S, *(sigma_s for _, sigma_s in parts))


def _by_sensor(config: Config) -> dict[str, list[str]]:
    """Return the constants that a sensor's offset is the sum of, of those whose clock is estimated."""
    estimated = {
        name: with_estimated_clock(sensor).parameters
        for name, sensor in sensors_of(config).items()
        if float(getattr(config.sensors[name], "time_offset_sigma_s", 0.0)) > 0.0
    }
    found = {name: [one.name(name) for one in priors if one.has_clock] for name, priors in estimated.items()}
    return {name: constants for name, constants in found.items() if constants}
