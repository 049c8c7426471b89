"""Which noise and drift of odometries is otherwise than configured: told once it is beyond doubt."""

from math import log

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.integrity.learnt_snapshot import WRONG, Factor, LearntScale, accelerometer_factor, gyroscope_factor
from holdfast.integrity.odometries import Odometries
from holdfast.measured_fields import NEVER_NS

REVIEW_NS = 10_000_000_000


class NoiseReview:
    """What was told of the odometries, of the gyroscope as they see it, and of the accelerometer as fixes see it.

    Args:
        imu: its name.
        log: where events go.
    """

    def __init__(self, imu: str, log: EventLog) -> None:
        self._imu, self._log = imu, log
        self._told: dict[tuple[str, str], float] = {}
        self._reviewed_ns = NEVER_NS

    def review(self, odometries: Odometries, accelerometer: LearntScale | None, now_ns: int) -> None:
        """Report what is new, every ten seconds."""
        if now_ns - self._reviewed_ns < REVIEW_NS:
            return
        self._reviewed_ns = now_ns
        learnt = odometries.learnt()
        for name, one in learnt.items():
            for factor in one.factors():
                self._report(name, factor, now_ns)
        for of_imu in gyroscope_factor(learnt.values()), accelerometer_factor(accelerometer):
            if of_imu is not None:
                self._report(self._imu, of_imu, now_ns)

    def _report(self, name: str, factor: Factor, now_ns: int) -> None:
        told = self._told.get((name, factor.what))
        if factor.is_wrong and (told is None or abs(log(factor.value / told)) > WRONG):
            self._told[name, factor.what] = factor.value
            self._log.report(EventKind.CALIBRATION, now_ns, name, in_words(factor))


def in_words(factor: Factor) -> str:
    """Return what a factor says of the file."""
    more = f"{factor.value:.1f} times more than" if factor.value > 1.0 else f"only {factor.value:.2f} times what"
    return f"{factor.what}: {more} {factor.keys[0]} says"
