"""One innovation test with hysteresis, for every sensor whose measurements one state explains.

A measurement that the state contradicts never enters. So many refused in a row lose the sensor, and so does silence;
then what comes waits in quarantine until so many in a row agree with the state, and enters together. After refusals
they must agree for a while: what is frozen agrees now and then, too.
"""

from collections import Counter
from enum import StrEnum

from holdfast.config.sensors import JudgedConfig
from holdfast.events import Outcome
from holdfast.sensors.sensor import Measurement

MIN_SILENCE_S = 1.0
PERIODS_OF_SILENCE = 3.0
CONSISTENT_NS = 2_000_000_000  # for so long measurements agree before a faulty sensor is regained


class Change(StrEnum):
    """What a measurement, or its absence, changed about its sensor."""

    NONE = "none"
    LOST = "lost"
    REGAINED = "regained"


class InnovationGate:
    """The trust in one sensor.

    Args:
        settings: as in its section of the configuration.
        can_fall_silent: whether its measurements come on their own; those of a constraint are made where the IMU is.
    """

    def __init__(self, settings: JudgedConfig, *, can_fall_silent: bool = True) -> None:
        self.limit = settings.gate_sigma**2
        self.is_lost = self._is_held = False
        self.reasons: Counter[Outcome] = Counter()  # of what was refused since a measurement entered last
        self._settings, self._can_fall_silent = settings, can_fall_silent
        self._refused_in_a_row = 0
        self._quarantine: list[Measurement] = []
        self._last_ns: int | None = None  # stamp of the newest measurement
        self._received_ns = 0  # what the IMU had reached then
        self._period_s = 0.0

    def note(self, measurement: Measurement, now_ns: int) -> None:
        """Note that a measurement came, whatever it is worth: the sensor is not silent."""
        if self._last_ns is not None and measurement.stamp_ns > self._last_ns:
            self._period_s = (measurement.stamp_ns - self._last_ns) * 1e-9
        self._last_ns, self._received_ns = measurement.stamp_ns, now_ns

    def pass_over(self, gap_ns: int) -> None:
        """Know that the IMU has not measured for so long: nothing that could come then is missing."""
        self._received_ns += gap_ns

    def hold(self, *, is_wrong: bool) -> None:
        """Lose the sensor while it is known to be wrong, whatever the state says."""
        self._is_held, self.is_lost = is_wrong, self.is_lost or is_wrong

    def judge(self, measurement: Measurement, nis: float | Outcome, now_ns: int) -> Outcome:
        """Say what a measurement is worth: USED where it may enter, QUARANTINED where it waits, else what is wrong.

        Args:
            measurement: in the order of stamps.
            nis: its normalised innovation squared, or why there is none.
            now_ns: time that the IMU has reached.
        """
        self.note(measurement, now_ns)
        if isinstance(nis, Outcome):
            return nis
        if self._is_held:
            return Outcome.CONTRADICTED
        if not nis <= self.limit:
            self._refused_in_a_row += 1
            self.reasons[Outcome.INNOVATION] += 1
            self._quarantine.clear()
            return Outcome.INNOVATION
        self._refused_in_a_row = 0
        if not self.is_lost:
            self.reasons.clear()
            return Outcome.USED
        if not self.reasons or measurement.stamp_ns <= now_ns:  # while the IMU is silent, what was refused soon fits
            self._quarantine.append(measurement)
        return Outcome.QUARANTINED

    def review(self, now_ns: int) -> Change:
        """Lose the sensor or regain it, if that is due."""
        if not self.is_lost:
            if self._refused_in_a_row >= self._settings.lose_after or self._is_silent(now_ns):
                self.is_lost = True
                return Change.LOST
        elif len(self._quarantine) >= self._settings.regain_after and self._is_consistent():
            self.is_lost = False
            self.reasons.clear()
            return Change.REGAINED
        return Change.NONE

    @property
    def contradicts(self) -> bool:
        """Whether the newest were refused, more than one: the state is wrong, or the sensor."""
        return self._refused_in_a_row > 1

    def take_quarantined(self) -> list[Measurement]:
        """Return what has waited."""
        waiting, self._quarantine = self._quarantine, []
        return waiting

    def reason(self) -> str:
        """Return why the sensor is lost, in words."""
        return in_words(self.reasons)

    def _is_consistent(self) -> bool:
        span_ns = self._quarantine[-1].stamp_ns - self._quarantine[0].stamp_ns
        return not self.reasons or span_ns >= CONSISTENT_NS

    def _is_silent(self, now_ns: int) -> bool:
        if self._last_ns is None or not self._can_fall_silent:
            return False
        return (now_ns - self._received_ns) * 1e-9 > max(MIN_SILENCE_S, PERIODS_OF_SILENCE * self._period_s)


def in_words(reasons: Counter[Outcome]) -> str:
    """Return why a sensor or a receiver is lost, from what was refused of it."""
    return ", ".join(f"{count} {outcome}" for outcome, count in reasons.items()) or "silent"
