"""The encoder of the turn joint: which readings can be used, and what they weigh."""

from math import isfinite, radians

from holdfast.config.sensors import JointConfig
from holdfast.events import Outcome
from holdfast.messages import JointAngle


class JointModel:
    """Checks and weighs; noise and trust in the zero are variances [rad^2]."""

    def __init__(self, config: JointConfig) -> None:
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.max_age_ns = round(config.max_age_s * 1e9)
        self.variance = radians(config.noise_deg) ** 2
        self.zero_variance = radians(config.zero_offset_sigma_deg) ** 2
        self._zero_rad = radians(config.zero_offset_deg)

    def check(self, reading: JointAngle) -> Outcome:
        """Say whether a reading can be used."""
        return Outcome.USED if isfinite(reading.angle_rad) else Outcome.NOT_FINITE

    def angle(self, reading: JointAngle) -> float:
        """Return the angle of the joint [rad] that a reading stands for."""
        return reading.angle_rad + self._zero_rad
