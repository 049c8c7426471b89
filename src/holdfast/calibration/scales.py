"""Scales of the distances of odometries, from the constants that the graph estimates."""

from collections.abc import Sequence
from math import exp, hypot, log

from holdfast.calibration.constants import combined, is_off, of_name
from holdfast.calibration.estimated import Estimated, Family, Found, judged
from holdfast.calibration.evidence import Evidence
from holdfast.config.model import Config
from holdfast.config.sensors import DriftingConfig
from holdfast.sensors.scale import IF_RIGHT, SCALE

FLOOR = 5e-4  # sigma: it changes with what is seen, and with the ground
DIGITS = 4


def scales(evidence: Sequence[Evidence], original: Config, config: Config) -> Found:
    """Return by which factor the distances of each odometry are to be multiplied; arguments are those of `clocks`."""
    estimates: list[Estimated] = []
    for name, section in original.sensors_of(DriftingConfig).items():
        known, prior = of_name(evidence, f"{name} {SCALE}"), section.scale_sigma
        if not known or prior == 0.0:
            continue
        offset, covariance = combined(known)
        after = config.sensors_of(DriftingConfig)[name].scale * exp(float(offset[0]))
        sigma, path = hypot(float(covariance[0, 0]) ** 0.5, FLOOR), ("sensors", name, "scale")
        found = judged(Estimated(Family.SCALES, path, name, "1", section.scale, after, after * sigma, prior))
        if not is_off(log(after / section.scale), sigma, prior, IF_RIGHT):
            found = found.kept(f"as configured, to the {100.0 * IF_RIGHT:g} % of one that is right")
        estimates.append(found)
    return Found.of(estimates, DIGITS)
