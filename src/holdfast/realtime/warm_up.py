"""The IMU path, run shortly before a sample is due, so that the sample finds the caches warm.

At 100 Hz a processor sleeps or serves others for 99 % of the time, and what the path then needs is no longer in its
caches: the first run takes two to three times as long as the second. The first one is done here, with the sample
before, on a twin of the path that shares no state with it.
"""

from time import monotonic

from holdfast.config.model import Config
from holdfast.estimator.imu_path import ImuPath
from holdfast.event_log import EventLog
from holdfast.messages import ImuSample, JointAngle
from holdfast.realtime.records import Published, Records
from holdfast.sensors.imu import ImuBuffer

LEAD_S = 0.0003  # before the next sample can come: longer than a warm-up takes, shorter than caches last
JITTERS = 2.5  # mean deviations by which a sample may come early
USUAL_PERIOD_S = 0.01  # between samples, until it is known
FOLLOWED, PERIOD_FOLLOWED = 0.1, 0.0025  # of a deviation, by the expected arrival and by the period: no overshoot
ANCHOR_NS = 1_000_000_000  # so long the twin goes on without a look at the real state
KEPT_NS = 2 * ANCHOR_NS


class WarmUp:
    """A twin of the IMU path, one sample behind.

    Args:
        config: of the estimator.
        records: the layouts of the shared memory.
    """

    def __init__(self, config: Config, records: Records) -> None:
        self._records = records
        self._log = EventLog(config.imu_name)
        self._buffer = ImuBuffer(config.imu)
        self._path = ImuPath(config, self._buffer, self._log)
        self._sample: ImuSample | None = None  # that the twin has not taken in
        self._new = 0  # samples since the last look at their times
        self._received_s = self._looked_s = self._expected_s = (
            monotonic()
        )  # newest arrival, that of the last look, next
        self._period_s, self._jitter_s = USUAL_PERIOD_S, 0.0
        self._anchor_ns = 0

    def note(self, sample: ImuSample) -> None:
        """Keep the sample that was just taken in for the next warm-up."""
        self._sample, self._received_s = sample, monotonic()
        self._new += 1

    def add_to_chassis(self, message: ImuSample | JointAngle) -> None:
        """Let the twin take in a reading of a sensor of the chassis or the turn joint."""
        self._path.add_to_chassis(message)

    @property
    def due_in_s(self) -> float | None:
        """In how many seconds it is time for a warm-up; None if there is no need of one before the next sample."""
        if self._sample is None:
            return None
        if self._new:
            self._expect()
        return max(0.0, self._expected_s - JITTERS * self._jitter_s - LEAD_S - monotonic())

    def _expect(self) -> None:
        """Follow the times at which samples come, as a phase-locked loop does."""
        count, self._new = self._new, 0
        expected_s = self._expected_s + (count - 1) * self._period_s
        late_s = self._received_s - expected_s
        if abs(late_s) > 0.5 * self._period_s:  # the first samples, or a silence
            self._period_s = (self._received_s - self._looked_s) / count
            expected_s = self._received_s
        else:
            self._period_s += PERIOD_FOLLOWED * late_s
            self._jitter_s += FOLLOWED * (abs(late_s) - self._jitter_s)
            expected_s += FOLLOWED * late_s
        self._looked_s, self._expected_s = self._received_s, expected_s + self._period_s

    def run(self, newest: Published | None) -> None:
        """Run the path with the sample before the next one, if that has not been done yet.

        Args:
            newest: what the optimiser published last; None before the start, when there is no path to run.
        """
        sample, self._sample = self._sample, None
        if sample is None or newest is None or newest.state is None:
            return
        received = self._path.receive(sample)
        if received is None:
            return
        if self._path.predictor is None or self._buffer.latest_ns - self._anchor_ns > ANCHOR_NS:
            self._path.start(newest.state, newest.gravity)
            self._anchor_ns = self._buffer.latest_ns
        estimate = self._path.propagate(received)
        if estimate is not None:
            self._path.chassis(estimate)
        self._records.pack_sample(newest.epoch, sample)
        self._buffer.forget_before(self._buffer.latest_ns - KEPT_NS)
        self._log.take_events()
