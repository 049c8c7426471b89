"""One odometry, and what is known of it: how it jumps, whether it is heard and trusted, and what was learnt of it."""

from enum import Enum

from holdfast.integrity.drift_monitor import DriftMonitor
from holdfast.integrity.far_delay import FAR_S
from holdfast.integrity.innovation import PERIODS_OF_SILENCE
from holdfast.integrity.learnt_snapshot import LearntOdometry
from holdfast.integrity.odometry_learning import OdometryLearning
from holdfast.integrity.odometry_trust import OdometryTrust
from holdfast.integrity.turn_rates import TurnRates
from holdfast.measured_fields import NEVER_NS
from holdfast.sensors.odometry import CONFIGURED, OdometryModel, OdometryNoise

DISTRUST = 3.0  # factor on the noise of an odometry that proves to be worse than configured
AGAIN_NS = 5_000_000_000  # an odometry whose noise is trebled twice in this time is lost
OFF_S, OFF_SIGMA = 0.05, 3.0  # both: so far off is a clock that is to be in the stamps
JUMPS, JUMPS_NS = 4, 20_000_000_000  # so many jumps in this time are no jumps but noise


class Jumps(Enum):
    """How often an odometry has jumped of late: too often to be as good as is configured, and on, with more noise."""

    FEW, OFTEN, WILD = range(3)


class MonitoredOdometry:
    """One odometry, as long as one start of the estimator lasts.

    Attributes:
        broken_ns: when its track broke last, by a jump, a slip or a new map: across that it holds the estimate no more.
        early_ns: by how much its stamps are known to be early; poses that come are dated by that.
        contradicts_ns: when it contradicted the IMU last, and the fixes said the same.
    """

    def __init__(self, model: OdometryModel, carried: LearntOdometry | None) -> None:
        self.model = model
        self.noise = OdometryNoise(model)
        self.monitor = DriftMonitor(self.noise)
        self.learning = OdometryLearning(self.noise, carried)
        self.trust = OdometryTrust(model.calibration)
        self.turn_rates = TurnRates()
        self.is_silent = self.is_stuck = False
        self.broken_ns = NEVER_NS
        self.early_ns = 0
        self.contradicts_ns = NEVER_NS
        self._heard_ns: int | None = None  # what the IMU had reached when a pose came last that was of use
        self._period_ns = 0
        self._jumps_ns: list[int] = []
        self._trebled_ns = NEVER_NS

    def note_jump(self, stamp_ns: int) -> Jumps:
        """Note a jump; trust the odometry less if it jumps too often to be as good as is configured."""
        self._jumps_ns = [jump for jump in self._jumps_ns if stamp_ns - jump < JUMPS_NS] + [stamp_ns]
        if len(self._jumps_ns) < JUMPS:
            return Jumps.FEW
        self._jumps_ns.clear()
        self.learning.trust_less(DISTRUST)
        before, self._trebled_ns = self._trebled_ns, stamp_ns
        return Jumps.WILD if stamp_ns - before < AGAIN_NS else Jumps.OFTEN

    def lose(self) -> None:
        """It is trusted no more: its jumps were no noise."""
        self.trust.lose()
        self.turn_rates.clear()
        self._jumps_ns.clear()
        self.forget_frame()

    def begin_anew(self) -> None:
        """Know no more of it than at first; it is not trusted yet."""
        self.noise.scale, self.noise.learnt = 1.0, CONFIGURED
        self.learning = OdometryLearning(self.noise)
        self.early_ns = 0
        self.lose()

    def break_track(self, now_ns: int) -> None:
        """The odometry has jumped, slipped or begun a new map."""
        self.broken_ns = now_ns
        self.forget_frame()

    def forget_frame(self) -> None:
        """The odometry has jumped or slipped, or the estimate was moved."""
        self.monitor.forget_frame()
        self.learning.forget_frame()

    @property
    def is_lost(self) -> bool:
        """Whether it is silent, or not trusted."""
        return self.is_silent or self.trust.is_lost

    @property
    def may_be_seconds_off(self) -> bool:
        """Whether its clock may be further off than a graph can tell: it is not trusted, or its clock is not."""
        is_far = self.trust.is_lost or abs(self.early_ns) > FAR_S * 1e9
        return is_far and self.model.config.time_offset_sigma_s > 0.0

    @property
    def parts_from_gyroscope(self) -> bool:
        """Whether it has of late turned otherwise than the gyroscope, by far, and no clock explains it."""
        return self.learning.parts_from_gyroscope and not self.learning.clock_trace.may_be_late

    def know_clock(self, early_s: float, sigma_s: float) -> None:
        """Date the poses that come by what is believed of its clock, and of that the sigma."""
        if abs(early_s - self.early_ns * 1e-9) > max(OFF_S, OFF_SIGMA * sigma_s):
            self.early_ns = round(early_s * 1e3) * 1_000_000

    def pass_over(self, gap_ns: int) -> None:
        """Know that the IMU has not measured for so long: no pose that could come then is missing."""
        if self._heard_ns is not None:
            self._heard_ns += gap_ns

    def hear(self, now_ns: int) -> None:
        """A pose came that is of use."""
        if self._heard_ns is not None and now_ns > self._heard_ns:
            self._period_ns = now_ns - self._heard_ns
        self._heard_ns = now_ns

    def falls_silent(self, now_ns: int) -> bool:
        """Whether no pose of use has come for long, by its rate."""
        patience_ns = max(self.model.config.silence_s * 1e9, PERIODS_OF_SILENCE * self._period_ns)
        return self._heard_ns is not None and now_ns - self._heard_ns > patience_ns
