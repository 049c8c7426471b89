"""The gate: which fixes may enter the graph, when an antenna is lost and when it is regained.

A trusted antenna's fixes are tested one by one; bad ones never enter. So many bad ones in a row lose the antenna, and
those that were used just before are taken out again. A lost antenna's fixes wait in quarantine until so many in a row
are good and agree with each other. What walks away slowly is the business of the witness.
"""

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from math import inf, sqrt

import gtsam
import numpy as np

from holdfast.config.model import GateConfig, GnssConfig
from holdfast.messages import Array
from holdfast.sensors.gnss import AntennaPosition
from holdfast.state import Outcome

HOLD_BACK = 4.0  # in units of the limit on NIS: twice the gate in sigma
AGREEMENT_SIGMA = 4.0  # fixes in quarantine are no further from their mean
COMPARED = 20  # with the mean of so many of the newest
STRAYS = 3  # so many in a row that disagree end a run of agreement
PERIODS_OF_SILENCE = 3
PUNCTUAL = 0.99  # fixes every two seconds are not always two seconds apart
UNKNOWN_PERIOD_S = 2.0  # before the second fix


class Trust(StrEnum):
    """What the gate thinks of an antenna."""

    TRUSTED = "trusted"
    LOST = "lost"


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What the graph expects of a fix.

    Attributes:
        innovation: (3,) fix minus prediction in W [m].
        of_state: (3, 3) covariance of the prediction [m^2].
        of_fix: (3, 3) covariance that the receiver claims [m^2].
        of_velocity: (3, 3) covariance of the velocity in W [m^2/s^2]: how fast the prediction may drift.
    """

    innovation: Array
    of_state: Array
    of_fix: Array
    of_velocity: Array

    @property
    def nis(self) -> float:
        """Normalised innovation squared: (21) in docs/math.md."""
        return float(self.innovation @ np.linalg.solve(self.of_state + self.of_fix, self.innovation))

    def smallest_visible_m(self, limit: float) -> float:
        """Return the jump [m] that a limit on NIS sees in every direction: the power of the gate."""
        return sqrt(limit * float(np.linalg.eigvalsh(self.of_state + self.of_fix)[-1]))


def predict(nav: gtsam.NavState, covariance: Array, p_I_G: Array, fix: AntennaPosition) -> Prediction:
    """Return what a state with covariance (9, 9) expects of a fix of the antenna at p_I_G (3,) [m]."""
    R_W_I = nav.attitude().matrix()
    H = np.zeros((3, 9))
    H[:, :3] = -R_W_I @ gtsam.SO3.Hat(p_I_G)
    H[:, 3:6] = R_W_I
    innovation = fix.p_W_G - nav.position() - R_W_I @ p_I_G
    of_velocity = R_W_I @ covariance[6:, 6:] @ R_W_I.T
    return Prediction(innovation, H @ covariance @ H.T, fix.covariance, of_velocity)


@dataclass(frozen=True, slots=True, eq=False)
class Waiting:
    """A fix of a lost antenna, with what was expected of it when it came."""

    fix: AntennaPosition
    prediction: Prediction


class AntennaGate:
    """Hysteresis over the fixes of one antenna, in the order of their stamps."""

    def __init__(self, gate: GateConfig, gnss: GnssConfig) -> None:
        self._gate = gate
        self.limit = gnss.gate_sigma**2
        self.trust = Trust.TRUSTED
        self._hold_s = 0.0
        self.reasons: Counter[Outcome] = Counter()  # of the bad fixes since the antenna was trusted last
        self.quarantine: list[Waiting] = []
        self.power_m = inf
        self._bad_in_a_row = 0
        self._last_good: AntennaPosition | None = None
        self._last_ns: int | None = None
        self._heard_ns = 0
        self._contradicting: list[Waiting] = []
        self._strays = 0
        self.period_s = UNKNOWN_PERIOD_S

    def judge(
        self, fix: AntennaPosition, prediction: Prediction, *, now_ns: int, baseline_agrees: bool = True
    ) -> Outcome:
        """Say what a fix is worth: USED where it may enter, QUARANTINED where it waits, else what is wrong with it.

        `now_ns` is the time that the IMU has reached: a fix may be late, but the antenna is not silent.
        """
        if self._last_ns is not None and fix.stamp_ns > self._last_ns:
            self.period_s = (fix.stamp_ns - self._last_ns) * 1e-9
        self._last_ns = fix.stamp_ns
        outcome = self._test(fix, prediction, baseline_agrees)
        if outcome is not Outcome.USED:
            self.refuse(outcome)
            self._note_contradiction(Waiting(fix, prediction), outcome)
            return outcome
        self._last_good, self._heard_ns = fix, now_ns
        self._bad_in_a_row = 0
        if self.trust is Trust.TRUSTED:
            return Outcome.USED
        self._wait(Waiting(fix, prediction))
        return Outcome.QUARANTINED

    def refuse(self, outcome: Outcome) -> None:
        """Count a bad fix, also one that the receiver itself calls bad."""
        self._bad_in_a_row += 1
        self.reasons[outcome] += 1
        self.quarantine.clear()

    def inflation(self, prediction: Prediction) -> float:
        """Return the factor on the covariance of a used fix: beyond the gate it loses weight before it is refused."""
        return max(1.0, prediction.nis / self.limit) ** 2 if self._gate.innovation else 1.0

    def loses(self, now_ns: int) -> bool:
        """Whether a trusted antenna is lost now, by bad fixes or by silence."""
        if self.trust is Trust.LOST:
            return False
        return self._bad_in_a_row >= self._gate.lose_after or self._is_silent(now_ns)

    def regains(self) -> bool:
        """Whether the fixes in quarantine are enough to trust a lost antenna again.

        After a lie they have to hold still for a while; after a silence or an honest warning they need not.
        """
        held = self.quarantine
        if self.trust is Trust.TRUSTED or len(held) < 2:
            return False
        span_s = (held[-1].fix.stamp_ns - held[0].fix.stamp_ns) * 1e-9
        if self._hold_s > 0.0:
            return span_s >= self._hold_s
        return span_s >= PUNCTUAL * self._gate.regain_s or len(held) >= self._gate.regain_after

    def believes(self, after_s: float) -> bool:
        """Whether fixes that contradict the estimate have agreed with each other for so long that they are right."""
        against = self._contradicting
        if len(against) < self._gate.regain_after:
            return False
        return (against[-1].fix.stamp_ns - against[0].fix.stamp_ns) * 1e-9 > after_s

    def distance_m(self) -> float:
        """Return how far the fixes that contradict lie from the estimate [m]."""
        return float(np.linalg.norm(self._contradicting[-1].prediction.innovation))

    def become(self, trust: Trust, *, hold_s: float = 0.0) -> list[Waiting]:
        """Trust or lose the antenna from now on; return the fixes that were in quarantine.

        Fixes must hold still for `hold_s` before the antenna is trusted again; without it, their number is enough.
        """
        held, self.quarantine = self.quarantine, []
        self.trust, self._hold_s = trust, hold_s
        self._bad_in_a_row, self._last_good = 0, None
        self._contradicting.clear()
        if trust is Trust.TRUSTED:
            self.reasons.clear()
        return held

    def _test(self, fix: AntennaPosition, prediction: Prediction, baseline_agrees: bool) -> Outcome:
        if self._is_too_fast(fix):
            return Outcome.TOO_FAST
        if self._gate.innovation:
            limit = HOLD_BACK * self.limit if self.trust is Trust.TRUSTED else self.limit
            self.power_m = prediction.smallest_visible_m(limit)
            if not prediction.nis <= limit:
                return Outcome.INNOVATION
        if self._gate.baseline and not baseline_agrees:
            return Outcome.BASELINE
        return Outcome.USED

    def _is_too_fast(self, fix: AntennaPosition) -> bool:
        """Whether the antenna would have had to move faster than it can since its last good fix (paper, IV-B)."""
        last = self._last_good
        if last is None:
            return False
        spread = AGREEMENT_SIGMA * sqrt(float(np.trace(fix.covariance + last.covariance)))
        reach = self._gate.max_speed_m_s * abs(fix.stamp_ns - last.stamp_ns) * 1e-9 + spread
        return float(np.linalg.norm(fix.p_W_G - last.p_W_G)) > reach

    def _is_silent(self, now_ns: int) -> bool:
        if self._last_good is None:
            return False
        patience_s = max(self._gate.silence_s, PERIODS_OF_SILENCE * self.period_s)
        return (now_ns - self._heard_ns) * 1e-9 > patience_s

    def _wait(self, waiting: Waiting) -> None:
        """Put a good fix into quarantine; if it disagrees with those that wait, they wait no longer."""
        held = self.quarantine
        if held and not _agree(held, waiting):
            held.clear()
        held.append(waiting)

    def _note_contradiction(self, waiting: Waiting, outcome: Outcome) -> None:
        """Keep the run of fixes that contradict the estimate but agree with each other, but for some strays."""
        against = self._contradicting
        if outcome is not Outcome.INNOVATION:
            return
        if against and not _agree(against[-COMPARED:], waiting):
            self._strays += 1
            if self._strays < STRAYS:
                return
            against.clear()
        self._strays = 0
        against.append(waiting)
        del against[1:-COMPARED]  # the first tells since when


def _agree(held: list[Waiting], waiting: Waiting) -> bool:
    """Whether an innovation lies near the mean of others, by the noise of the fixes and the drift of the prediction."""
    mean = np.mean([one.prediction.innovation for one in held], axis=0)
    miss = waiting.prediction.innovation - mean
    since_s = float(np.mean([waiting.fix.stamp_ns - one.fix.stamp_ns for one in held])) * 1e-9
    spread = waiting.fix.covariance * (1.0 + 1.0 / len(held)) + waiting.prediction.of_velocity * since_s**2
    return float(miss @ np.linalg.solve(spread, miss)) <= AGREEMENT_SIGMA**2
