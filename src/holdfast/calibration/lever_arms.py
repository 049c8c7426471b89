"""Lever arms of antennas, from runs in which the graph estimates them."""

from collections.abc import Sequence
from math import hypot
from typing import Any

import numpy as np

from holdfast.calibration.constants import combined, of_name
from holdfast.calibration.estimated import Estimated, Family, Found, judged
from holdfast.calibration.evidence import Evidence
from holdfast.calibration.placing import corrected, entry_of
from holdfast.config.edit import Change
from holdfast.config.model import Config
from holdfast.config.sensors import GnssConfig, HeadingConfig
from holdfast.sensors.lever_arm import ARM

PRIOR_M = 0.05  # how well a tape measures
SLOW_M = 0.005, 0.005, 0.01  # sigma: slow errors of fixes, which a machine that hardly turns takes for an arm


def with_estimated_arms(config: Config) -> tuple[Config, list[str]]:
    """Return a configuration whose lever arms are estimated, and the sensors that are of no use with it.

    A heading between two antennas rests on their arms. Clocks are taken as known, so that each arm is a constant of its
    own.
    """
    sensors: dict[str, Any] = dict(config.sensors)
    for name, section in config.sensors_of(GnssConfig).items():
        sensors[name] = section.model_copy(update={"lever_arm_sigma_m": PRIOR_M, "time_offset_sigma_s": 0.0})
    resting = [name for name, one in config.sensors_of(HeadingConfig).items() if one.mounting_yaw_deg is None]
    return config.model_copy(update={"sensors": sensors}), resting


def lever_arms(evidence: Sequence[Evidence], original: Config, config: Config) -> Found:
    """Return where the antennas are, in the axes of I, beside where they were configured.

    Args:
        evidence: of runs with `with_estimated_arms`.
        original: the configuration before the calibration.
        config: that of the runs.
    """
    estimates: list[Estimated] = []
    changes: list[Change] = []
    for name in original.sensors_of(GnssConfig):
        known, frame = of_name(evidence, f"{name} {ARM}"), original.frame_of(name)
        if not known:
            continue
        offset, covariance = combined(known)
        offset += config.T_I(frame)[:3, 3] - original.T_I(frame)[:3, 3]
        path = "extrinsics", entry_of(original, frame), "translation_m"
        sigmas = [hypot(one, floor) for one, floor in zip(np.sqrt(covariance.diagonal()), SLOW_M, strict=True)]
        rows = [
            judged(
                Estimated(Family.LEVER_ARMS, path, f"{name}, along {axis} of the IMU", "m", 0.0, value, sigma, PRIOR_M)
            )
            for axis, value, sigma in zip("xyz", offset.tolist(), sigmas, strict=True)
        ]
        correction = np.eye(4)
        seen = np.array([one.after if one.is_observable else 0.0 for one in rows])
        correction[:3, 3] = original.T_I(frame)[:3, :3].T @ seen
        rows, written = corrected(original, frame, correction, rows)
        estimates += rows
        changes += written
    return Found(estimates, changes)
