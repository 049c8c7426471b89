"""Rotations of the mountings of odometries and of headings, from the constants that the graph estimates."""

from collections.abc import Sequence
from math import degrees, hypot

import gtsam
import numpy as np

from holdfast.calibration.constants import combined, of_name
from holdfast.calibration.estimated import Estimated, Family, Found, judged
from holdfast.calibration.evidence import Evidence
from holdfast.calibration.placing import corrected, entry_of
from holdfast.config.model import Config
from holdfast.config.sensors import DriftingConfig, HeadingConfig
from holdfast.sensors.heading import MOUNT, configured_yaw_deg

FLOOR_DEG = 0.02  # sigma: errors of the gyroscope's scale and axes turn with the machine, too
DIGITS = 2  # of degrees


def mountings(evidence: Sequence[Evidence], original: Config, config: Config) -> Found:
    """Return how headings are mounted, and by how much each odometry is rotated about its axes as configured at first.

    Arguments are those of `clocks`. An axis that was not seen stays where it is.
    """
    of_headings = _of_headings(evidence, original, config)
    estimates, changes = list(of_headings.estimates), list(of_headings.changes)
    for name, section in original.sensors_of(DriftingConfig).items():
        known, prior = of_name(evidence, name), section.mounting_sigma_deg
        if not known or prior == 0.0:
            continue
        frame = original.frame_of(name)
        offset, covariance = combined(known)
        before, now = (gtsam.Rot3(one.T_I(frame)[:3, :3]) for one in (original, config))
        total = np.degrees(gtsam.Rot3.Logmap(before.between(now.compose(gtsam.Rot3.Expmap(offset[:3])))))
        sigmas = [hypot(float(one), FLOOR_DEG) for one in np.degrees(np.sqrt(covariance.diagonal()[:3]))]
        path = "extrinsics", entry_of(original, frame), "rotation"
        rows = [
            judged(Estimated(Family.MOUNTINGS, path, f"{name}, about its {axis}", "deg", 0.0, value, sigma, prior))
            for axis, value, sigma in zip("xyz", total.tolist(), sigmas, strict=True)
        ]
        correction = np.eye(4)
        seen = [one.after if one.is_observable else 0.0 for one in rows]
        correction[:3, :3] = gtsam.Rot3.Expmap(np.radians(seen)).matrix()
        rows, written = corrected(original, frame, correction, rows)
        estimates += rows
        changes += written
    return Found(estimates, changes)


def _of_headings(evidence: Sequence[Evidence], original: Config, config: Config) -> Found:
    estimates: list[Estimated] = []
    for name, section in original.sensors_of(HeadingConfig).items():
        known, prior = of_name(evidence, f"{name} {MOUNT}"), section.mounting_sigma_deg
        if not known or prior == 0.0:
            continue
        offset, covariance = combined(known)
        before, now = (configured_yaw_deg(name, one) for one in (original, config))
        path, sigma = ("sensors", name, "mounting_yaw_deg"), hypot(degrees(covariance[0, 0] ** 0.5), FLOOR_DEG)
        after = now + degrees(offset[0])
        estimates.append(judged(Estimated(Family.MOUNTINGS, path, name, "deg", before, after, sigma, prior)))
    return Found.of(estimates, DIGITS)
