"""The IMU path, walked shortly before a sample is due, so that the sample finds the caches warm.

At 100 Hz a processor sleeps or serves others for 99 % of the time, and what the path then needs is no longer in its
caches: the first walk takes two to three times as long as the second. The first one is done here, with the sample
before, on a twin of the path that shares no state with it.
"""

from time import monotonic

from holdfast.config.model import Config
from holdfast.estimator.imu_path import ImuPath
from holdfast.estimator.journal import Journal
from holdfast.messages import ImuSample, JointAngle
from holdfast.realtime.records import Published, pack_sample
from holdfast.sensors.imu import ImuBuffer

LEAD_S = 0.0005  # before the next sample is expected: longer than a rehearsal takes, shorter than caches last
USUAL_PERIOD_S = 0.01  # between samples, until it is known
FOLLOWED = 0.1  # how fast the expected period follows the last one
ANCHOR_NS = 1_000_000_000  # so long the twin goes on without a look at the real state
KEPT_NS = 2 * ANCHOR_NS


class Rehearsal:
    """A twin of the IMU path, one sample behind.

    Args:
        config: of the estimator.
    """

    def __init__(self, config: Config) -> None:
        self._journal = Journal()
        self._buffer = ImuBuffer(config.sensors.imu)
        self._path = ImuPath(config, self._buffer, self._journal)
        self._sample: ImuSample | None = None  # that the twin has not taken in
        self._heard_s = self._heard_before_s = monotonic()
        self._period_s = USUAL_PERIOD_S
        self._anchor_ns = 0

    def note(self, sample: ImuSample) -> None:
        """Keep the sample that was just taken in for the next rehearsal."""
        self._sample = sample
        self._heard_s, self._heard_before_s = monotonic(), self._heard_s

    def add_to_base(self, message: ImuSample | JointAngle) -> None:
        """Let the twin hear what a sensor of the chassis or the turn joint says."""
        self._path.add_to_base(message)

    @property
    def due_in_s(self) -> float | None:
        """In how many seconds it is time for a rehearsal; None if there is no need of one before the next sample."""
        if self._sample is None:
            return None
        return max(0.0, self._heard_s + self._period_s - LEAD_S - monotonic())

    def run(self, newest: Published | None) -> None:
        """Walk the path with the sample before the next one, if that has not been done yet.

        Args:
            newest: what the optimiser published last; None before the start, when there is no path to walk.
        """
        sample, self._sample = self._sample, None
        if sample is None or newest is None or newest.state is None:
            return
        self._period_s += FOLLOWED * (self._heard_s - self._heard_before_s - self._period_s)
        heard = self._path.hear(sample)
        if heard is None:
            return
        if self._path.predictor is None or self._buffer.latest_ns - self._anchor_ns > ANCHOR_NS:
            self._path.start(newest.state, newest.gravity)
            self._anchor_ns = self._buffer.latest_ns
        estimate = self._path.propagate(heard)
        if estimate is not None:
            self._path.chassis(estimate)
        pack_sample(newest.epoch, sample)
        self._buffer.forget_before(self._buffer.latest_ns - KEPT_NS)
        self._journal.take_events()
