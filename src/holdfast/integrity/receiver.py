"""The gate of a receiver: which positions may enter the graph, when the receiver is lost and when it is regained.

A trusted receiver's positions are tested one by one; bad ones never enter. So many bad ones in a row lose it, and those
that were used just before are taken out again. A lost receiver's positions wait in quarantine until so many in a row
are good and agree with each other. What walks away slowly is the business of the drift monitor.
"""

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import takewhile
from math import inf, sqrt

import numpy as np

from holdfast.config.model import GateConfig
from holdfast.events import Outcome
from holdfast.integrity.innovation import PERIODS_OF_SILENCE
from holdfast.messages import Array
from holdfast.sensors.sensor import Innovation, Position, State

HOLD_BACK = 4.0  # in units of the limit on NIS: twice the gate in sigma
UNCHANGED = np.zeros((3, 3))
AGREEMENT_SIGMA = 4.0  # positions in quarantine are no further from their mean
COMPARED = 20  # with the mean of so many of the newest
OUTLIERS = 3  # so many in a row that disagree end a run of agreement
PUNCTUAL = 0.99  # positions every two seconds are not always two seconds apart
FASTER = 1.5  # than it has ever been a machine may become
FIRST_S = 20.0  # after a start the first position may come so late
UNKNOWN_PERIOD_S = 2.0  # before the second fix
UNEXPECTED_S = 5.0  # positions after a silence that the estimate does not expect are consistent for so long


class Trust(StrEnum):
    """Whether the positions of a receiver may enter the graph."""

    TRUSTED = "trusted"
    LOST = "lost"


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the graph expects of a position.

    Attributes:
        innovation: (3,) position minus prediction in W [m].
        of_state: (3, 3) covariance of the prediction [m^2].
        of_position: (3, 3) covariance that is claimed [m^2].
        of_velocity: (3, 3) covariance of the velocity in W [m^2/s^2]: how fast the prediction may drift.
        speed_m_s: of the machine.
    """

    innovation: Array
    of_state: Array
    of_position: Array
    of_velocity: Array
    speed_m_s: float = 0.0

    @cached_property
    def nis(self) -> float:
        """Normalised innovation squared: (21) in docs/math.md."""
        return float(self.innovation @ np.linalg.solve(self.of_state + self.of_position, self.innovation))

    @property
    def least_speed_m_s(self) -> float:
        """The speed that the machine has at least [m/s]."""
        return self.speed_m_s - AGREEMENT_SIGMA * sqrt(float(np.trace(self.of_velocity)))

    def smallest_visible_m(self, limit: float) -> float:
        """Return the jump [m] that a limit on NIS sees in every direction: the power of the gate."""
        return sqrt(limit * float(np.linalg.eigvalsh(self.of_state + self.of_position)[-1]))


def predict(innovation: Innovation, state: State) -> Prediction:
    """Return what a state expects of a position, given the innovation of that at the state."""
    R_W_I = state.nav.attitude().matrix()
    of_velocity = R_W_I @ state.covariance[6:9, 6:9] @ R_W_I.T
    speed_m_s = float(np.linalg.norm(state.nav.velocity()))
    return Prediction(innovation.y, innovation.of_state(state), innovation.R, of_velocity, speed_m_s)


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """A position of a lost receiver, with what was expected of it when it came."""

    position: Position
    prediction: Prediction


class ReceiverGate:
    """Hysteresis over the positions of one receiver, in the order of their stamps; `limit` bounds their NIS.

    `since_ns` is when they began to be expected.
    """

    def __init__(self, gate: GateConfig, limit: float, since_ns: int) -> None:
        self._gate = gate
        self.limit = limit
        self._fastest_m_s = gate.max_speed_m_s
        self.trust = Trust.TRUSTED
        self._hold_s = 0.0
        self.reasons: Counter[Outcome] = Counter()  # of the bad positions since the receiver was trusted last
        self.quarantine: list[Held] = []
        self._tested: tuple[Prediction, float] | None = None  # the newest, with the limit on its NIS
        self._bad_in_a_row = 0
        self._last_good: Position | None = None
        self._last_ns: int | None = None
        self._received_ns = since_ns
        self._contradicting: list[Held] = []
        self._outliers = 0
        self.period_s = UNKNOWN_PERIOD_S

    @property
    def power_m(self) -> float:
        """The jump [m] that the gate would have seen in the position that it tested last, in every direction."""
        return inf if self._tested is None else self._tested[0].smallest_visible_m(self._tested[1])

    @property
    def leads(self) -> bool:
        """Whether positions of the receiver lead the estimate: one that has not measured yet is trusted, too."""
        return self.trust is Trust.TRUSTED and self._last_ns is not None

    @property
    def limit_on_nis(self) -> float:
        """The NIS beyond which a position is refused now: of a receiver that was never wrong it weighs less first."""
        if not self._gate.innovation:
            return inf
        is_innocent = self.trust is Trust.TRUSTED or self._hold_s == 0.0
        return HOLD_BACK * self.limit if is_innocent else self.limit

    def judge(
        self, position: Position, prediction: Prediction, *, now_ns: int, baseline_agrees: bool = True
    ) -> Outcome:
        """Say what a position is worth: USED where it may enter, QUARANTINED where it waits, else what is wrong.

        `now_ns` is the time that the IMU has reached: a position may be late, but the receiver is not silent.
        """
        if self._last_ns is not None and position.stamp_ns > self._last_ns:
            self.period_s = (position.stamp_ns - self._last_ns) * 1e-9
        self._last_ns = position.stamp_ns
        outcome = self._test(position, prediction, baseline_agrees)
        if outcome is not Outcome.USED:
            self.refuse(outcome)
            self._note_contradiction(Held(position, prediction), outcome)
            return outcome
        self._last_good, self._received_ns = position, now_ns
        self._bad_in_a_row = 0
        if self.trust is Trust.TRUSTED:
            self._fastest_m_s = max(self._fastest_m_s, FASTER * prediction.least_speed_m_s)
            return Outcome.USED
        self._wait(Held(position, prediction))
        return Outcome.QUARANTINED

    def pass_over(self, gap_ns: int) -> None:
        """Know that the IMU has not measured for so long: no position that could come then is missing."""
        self._received_ns += gap_ns

    def refuse(self, outcome: Outcome) -> None:
        """Count a bad position, also one that the receiver itself reports as bad."""
        self._bad_in_a_row += 1
        self.reasons[outcome] += 1
        self.quarantine.clear()

    def inflation(self, prediction: Prediction) -> float:
        """Return the factor on the covariance of a used position, which weighs less beyond the gate."""
        return max(1.0, prediction.nis / self.limit) ** 2 if self._gate.innovation else 1.0

    def loses(self, now_ns: int) -> bool:
        """Whether a trusted receiver is lost now, by bad positions or by silence."""
        if self.trust is Trust.LOST:
            return False
        return self._bad_in_a_row >= self._gate.lose_after or self._is_silent(now_ns)

    def regains(self) -> bool:
        """Whether the positions in quarantine are enough to trust a lost receiver again.

        After faulty positions they have to be consistent for a while; after a silence or a warning they need not,
        unless the estimate does not expect them: either it has drifted further than it knows, or they are wrong.
        """
        held = self.quarantine
        if self.trust is Trust.TRUSTED or len(held) < 2:
            return False
        if self._hold_s > 0.0:
            return _span_s(held) >= self._hold_s
        if _span_s(held) >= UNEXPECTED_S and len(held) >= self._gate.regain_after:
            return True
        expected = list(
            takewhile(lambda one: not self._gate.innovation or one.prediction.nis <= self.limit, held[::-1])
        )
        if len(expected) < 2:
            return False
        return _span_s(expected) >= PUNCTUAL * self._gate.regain_s or len(expected) >= self._gate.regain_after

    def contradicts_for(self, after_s: float) -> bool:
        """Whether positions that contradict the estimate have agreed with each other for so long [s]."""
        against = self._contradicting
        if len(against) < self._gate.regain_after:
            return False
        return (against[-1].position.stamp_ns - against[0].position.stamp_ns) * 1e-9 > after_s

    def distance_m(self) -> float:
        """Return how far the positions that contradict lie from the estimate [m]."""
        return float(np.linalg.norm(self._contradicting[-1].prediction.innovation))

    def become(self, trust: Trust, *, hold_s: float = 0.0) -> list[Held]:
        """Trust or lose the receiver from now on; return the positions that were in quarantine.

        Fixes must be consistent for `hold_s` before the receiver is trusted again; without it, their number is enough.
        """
        held, self.quarantine = self.quarantine, []
        self.trust, self._hold_s = trust, hold_s
        self._bad_in_a_row, self._last_good = 0, None
        self._contradicting.clear()
        if trust is Trust.TRUSTED:
            self.reasons.clear()
        return held

    def _test(self, position: Position, prediction: Prediction, baseline_agrees: bool) -> Outcome:
        if self._is_too_fast(position):
            return Outcome.TOO_FAST
        if self._gate.innovation:
            self._tested = prediction, self.limit_on_nis
            if not prediction.nis <= self.limit_on_nis:
                return Outcome.INNOVATION
        if self._gate.baseline and not baseline_agrees:
            return Outcome.BASELINE
        return Outcome.USED

    def _is_too_fast(self, position: Position) -> bool:
        """Whether the receiver would have had to move faster than it can since its last good position (paper, IV-B).

        A machine that has moved faster than was configured can do so.
        """
        last = self._last_good
        if last is None:
            return False
        noise_m = AGREEMENT_SIGMA * sqrt(float(np.trace(position.covariance + last.covariance)))
        reach = self._fastest_m_s * abs(position.stamp_ns - last.stamp_ns) * 1e-9 + noise_m
        return float(np.linalg.norm(position.p_W_P - last.p_W_P)) > reach

    def _is_silent(self, now_ns: int) -> bool:
        if self._last_good is None and self._last_ns is not None:
            return False  # what came since was refused
        usual_s = FIRST_S if self._last_ns is None else PERIODS_OF_SILENCE * self.period_s
        patience_s = max(self._gate.silence_s, usual_s)
        return (now_ns - self._received_ns) * 1e-9 > patience_s

    def _wait(self, one: Held) -> None:
        """Put a good position into quarantine; if it disagrees with those that wait, they wait no longer."""
        if self.quarantine and not _agree(self.quarantine, one, _changed(self.quarantine, one)):
            self.quarantine.clear()
        self.quarantine.append(one)

    def _note_contradiction(self, one: Held, outcome: Outcome) -> None:
        """Keep the run of positions that contradict the estimate but agree with each other, but for some outliers."""
        against = self._contradicting
        if outcome is not Outcome.INNOVATION:
            return
        if against and not _agree(against[-COMPARED:], one):
            self._outliers += 1
            if self._outliers < OUTLIERS:
                return
            against.clear()
        self._outliers = 0
        against.append(one)
        del against[1:-COMPARED]  # the first tells since when


def _span_s(held: list[Held]) -> float:
    """Return the time between the first and the last of some positions [s]."""
    return abs(held[-1].position.stamp_ns - held[0].position.stamp_ns) * 1e-9


def _agree(others: list[Held], one: Held, changed: Array = UNCHANGED) -> bool:
    """Whether an innovation lies near the mean of others, by the noise of both and the drift of the prediction.

    `changed` (3, 3) is the covariance of how other sensors have moved the prediction meanwhile [m^2].
    """
    residual = one.prediction.innovation - np.mean([other.prediction.innovation for other in others], axis=0)
    since_s = float(np.mean([one.position.stamp_ns - other.position.stamp_ns for other in others])) * 1e-9
    covariance = one.position.covariance * (1.0 + 1.0 / len(others)) + one.prediction.of_velocity * since_s**2
    return float(residual @ np.linalg.solve(covariance + changed, residual)) <= AGREEMENT_SIGMA**2


def _changed(others: list[Held], one: Held) -> Array:
    """Return the covariance (3, 3) of how a prediction moved: corrected by what shrank, drifted by what grew [m^2]."""
    shrunk = np.mean([other.prediction.of_state for other in others], axis=0) - one.prediction.of_state
    values, axes = np.linalg.eigh(shrunk)
    covariance: Array = (axes * np.abs(values)) @ axes.T
    return covariance
