"""The encoder of the turn joint: which readings can be used, what they weigh, and when it repeats an old one."""

from math import inf, isfinite, radians, sqrt

from holdfast.config.sensors import JointConfig
from holdfast.messages import JointAngle
from holdfast.state import Outcome

FROZEN_SIGMAS = 10.0  # rotated by so many sigmas of a reading ...
FROZEN_STEPS = 3.0  # ... and by so many steps of the encoder without a new reading, it is frozen


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


class RepeatMonitor:
    """How far the joint has turned by the gyroscopes while the encoder repeated the same reading.

    An encoder that stands still repeats itself, and so does one with a coarse step: a reading may be as old as the
    first of its run. It is frozen where that is more than noise and steps explain: (35) in docs/math.md.
    """

    def __init__(self, variance: float) -> None:
        self._least_rad = FROZEN_SIGMAS * sqrt(variance)
        self._reading_rad: float | None = None
        self._step_rad = inf
        self._since_ns = 0
        self._rotation_rad = 0.0
        self.is_frozen = False

    def hidden_rotation(
        self, stamp_ns: int, reading_rad: float, rotation_rad: float, rate_noise: tuple[float, float] | None
    ) -> float:
        """Take in a reading and return by how much the joint has turned for sure since it was first read [rad].

        Args:
            stamp_ns: of the reading, later than those before.
            reading_rad: the angle.
            rotation_rad: integral of the joint's rate until the stamp, from any time on.
            rate_noise: of that rate, white [rad^2/s] and variance of its bias [rad^2/s^2]; None where the rate itself
                comes from the encoder, so that nothing can be told.
        """
        if self._reading_rad is None or reading_rad != self._reading_rad:
            if self._reading_rad is not None:
                self._step_rad = min(self._step_rad, abs(reading_rad - self._reading_rad))
            self._reading_rad, self._since_ns, self._rotation_rad = reading_rad, stamp_ns, rotation_rad
            self.is_frozen = False
            return 0.0
        if rate_noise is None:
            return 0.0
        since_s = (stamp_ns - self._since_ns) * 1e-9
        unsure = 4.0 * sqrt(rate_noise[0] * since_s + rate_noise[1] * since_s**2)
        hidden = max(0.0, abs(rotation_rad - self._rotation_rad) - unsure)
        steps = FROZEN_STEPS * self._step_rad if self._step_rad < inf else 0.0
        self.is_frozen = hidden > max(self._least_rad, steps)
        return hidden
