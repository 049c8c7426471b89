"""Drives the estimator with a stream of messages, and measures how long each took."""

from array import array
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from time import perf_counter, perf_counter_ns, sleep
from typing import TYPE_CHECKING

import numpy as np

from holdfast.config.model import Config
from holdfast.errors import EstimatorError
from holdfast.estimator.estimator import Estimator
from holdfast.event_log import MeasurementRecord
from holdfast.events import EventKind, Health, Outcome
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.messages import Message
from holdfast.replay.datum_check import DatumCheck
from holdfast.replay.held_out import HeldOutJudge, HoldOut, HoldOutFilter, Judgement
from holdfast.replay.interrupts import Uninterrupted
from holdfast.replay.measurements import HELD_OUT
from holdfast.replay.outputs import Outputs
from holdfast.report.track import JudgedTrack
from holdfast.smoothing.batch_smoother import BatchSmoother
from holdfast.smoothing.block import Block
from holdfast.state import Estimate, Output

if TYPE_CHECKING:  # starting processes is left to whoever wants them
    from holdfast.realtime.engine import RealtimeEstimator


CLOCK_STEP_NS = 3_600_000_000_000  # between two arrivals: not a silence, but a clock that was set


@dataclass(slots=True)
class Timing:
    """Processing times: `imu_ns` per IMU sample without, `update_ns` per message with an optimisation."""

    imu_ns: "array[int]" = field(default_factory=lambda: array("q"))
    update_ns: "array[int]" = field(default_factory=lambda: array("q"))
    wall_s: float = 0.0
    recorded_s: float = 0.0

    @property
    def real_time_factor(self) -> float | None:
        """How much faster than the recording it went; None before it went."""
        return self.recorded_s / self.wall_s if self.wall_s > 0.0 else None


class Replay:
    """One replay of one stream; `run` may be interrupted, what was done until then stays valid.

    Args:
        config: of the estimator.
        outputs: where to write; without it nothing is written.
        hold_out: what to hold back from the estimator, to judge it.
        keep_track: keep the causal track in memory for a figure.
        realtime: the engine to be used instead of the estimator in one process; whoever made it closes it.
        batch: finds the optimum over the recording; not with `realtime`.
        learnt: what was learnt of the sensors before; the engine has been given it.
        on_block: takes each stretch of it as soon as it is done.
        on_output: takes the output of each message.
    """

    def __init__(
        self,
        config: Config,
        outputs: Outputs | None = None,
        hold_out: Iterable[HoldOut] = (),
        keep_track: bool = False,
        *,
        realtime: "RealtimeEstimator | None" = None,
        batch: BatchSmoother | None = None,
        learnt: LearntSnapshot = NOTHING_LEARNT,
        on_block: Callable[[Block], object] = lambda _: None,
        on_output: Callable[[Output], None] = lambda _: None,
    ) -> None:
        self.estimator: Estimator | RealtimeEstimator = realtime or Estimator(config, batch, learnt=learnt)
        self._realtime, self._batch, self._on_block = realtime, batch, on_block
        self._on_output = on_output
        if outputs is not None and isinstance(self.estimator, Estimator):
            self.estimator.keep_records()
        self.timing = Timing()
        self.health: Counter[Health] = Counter()  # estimates by health
        self.warnings: list[str] = []  # known once it has run and events are written
        self.causal = HeldOutJudge(config, self.estimator)
        self.smoothed = HeldOutJudge(config, self.estimator)
        self.batch = HeldOutJudge(config, self.estimator)
        self._filter = HoldOutFilter(hold_out, config)
        self._datum_check = DatumCheck(config)
        self._outputs = outputs
        self._judged = 0  # held-out positions that were written
        self._imu_name = config.imu_name
        self._kept: list[tuple[int, float, float, float]] | None = [] if keep_track else None

    def run(
        self, messages: Iterable[Message], rate: float | None = None, progress: Callable[[int], None] | None = None
    ) -> None:
        """Process all messages, as fast as possible or at `rate` times the pace of their arrival.

        Args:
            messages: in the order of arrival.
            rate: 1.0 is the pace of the recording.
            progress: called with the arrival [ns] every now and then.
        """
        if self._realtime is not None:
            self._realtime.wait_until_ready()
        began, last_ns, recorded_ns = perf_counter(), 0, 0
        uninterrupted = Uninterrupted()
        uninterrupted.start()
        try:
            for count, message in enumerate(self._filter.split(messages)):
                since_ns, last_ns = message.arrival_ns - (last_ns or message.arrival_ns), message.arrival_ns
                recorded_ns += since_ns if 0 < since_ns < CLOCK_STEP_NS else 0
                if rate is not None:
                    ahead_s = recorded_ns * 1e-9 / rate - (perf_counter() - began)
                    if ahead_s > 0.0:
                        sleep(ahead_s)
                self._datum_check.add(message)
                with uninterrupted:
                    self._process(message)
                if progress is not None and count % 500 == 0:
                    progress(last_ns)
            self.warnings += self._filter.warnings()
            if (far := self._datum_check.warning) is not None:
                self.warnings.append(far)
        finally:
            uninterrupted.stop()
            self._end_batch()
            self.timing.wall_s = perf_counter() - began
            self.timing.recorded_s = recorded_ns * 1e-9
            if self._realtime is not None:
                self._take(self._realtime.flush(), last_ns)
                self.timing.update_ns.extend(self._realtime.take_update_times())
            elif isinstance(self.estimator, Estimator):
                self._judge(Output())
                self.estimator.close()
                self._write_measurements(self.estimator)

    def _process(self, message: Message) -> None:
        began_ns = perf_counter_ns()
        output = self.estimator.process(message)
        took_ns = perf_counter_ns() - began_ns
        if output.optimised is not None and self._realtime is None:
            self.timing.update_ns.append(took_ns)
        elif message.sensor == self._imu_name:
            self.timing.imu_ns.append(took_ns)
        self._take(output, message.arrival_ns)
        if self._batch is not None:
            self._take_blocks(self._batch)

    def _end_batch(self) -> None:
        if self._batch is not None:
            self._judge(Output())
            self._batch.stop()
            self._take_blocks(self._batch)

    def _take_blocks(self, batch: BatchSmoother) -> None:
        for done in batch.take():
            block = done.stamped(self.stamp)
            self._on_block(block)
            if self._filter:
                self.batch.add_block(block, self.estimator.world)

    def _take(self, output: Output, now_ns: int) -> None:
        self._on_output(output)
        if self._outputs is not None:
            self._outputs.write(output)
            self._outputs.diagnose(self.estimator, now_ns)
            self.write_events()
            if isinstance(self.estimator, Estimator):
                self._write_measurements(self.estimator)
        if output.estimate is not None:
            self.health[self.estimator.health] += 1
        self._judge(output)

    def _write_measurements(self, estimator: Estimator) -> None:
        if self._outputs is not None:
            self._outputs.write_measurements(estimator.take_records())

    def write_events(self) -> None:
        """Write the events since the last call."""
        if self._outputs is not None and self.estimator.events:
            events = self.estimator.take_events()
            assumed = [event for event in events if event.kind is EventKind.COVARIANCE_ASSUMED]
            self.warnings += [f"{event.sensor}: {event.reason}" for event in assumed]
            self._outputs.write_events(events)

    def _judge(self, output: Output) -> None:
        while self._filter.held:
            message, in_outage = self._filter.held.popleft()
            self.causal.add_message(message, in_outage)
            self.smoothed.add_message(message, in_outage)
            if self._batch is not None:
                self.batch.add_message(message, in_outage)
        frame = self.estimator.world
        if output.estimate is not None and self._kept is not None:
            self._keep(output.estimate)
        if not self._filter:  # a track is of no use where nothing is to be judged by it
            return
        if output.estimate is not None:
            self.causal.add_estimate(output.estimate, frame)
        if output.optimised is not None:
            self.causal.add_optimised(output.optimised, frame)
        for stamp_ns, nav in output.smoothed:
            self.smoothed.add_smoothed(stamp_ns, nav, frame)
        self._write_held_out()

    def _write_held_out(self) -> None:
        """Write the positions that were judged since the last call."""
        judged, self._judged = self.causal.judgements[self._judged :], len(self.causal.judgements)
        if self._outputs is not None:
            self._outputs.write_measurements((_held_out_record(one) for one in judged), HELD_OUT)

    def _keep(self, estimate: Estimate) -> None:
        assert self._kept is not None
        east, north, _ = estimate.nav.position()
        R = estimate.nav.attitude().matrix()[:2]
        variance = float(np.trace(R @ estimate.covariance[3:6, 3:6] @ R.T))
        self._kept.append((estimate.stamp_ns, east, north, variance))

    def stamp(self, time_ns: int) -> int:
        """Return the stamp of the recording at a time of the estimator."""
        return self.estimator.stamp(time_ns) if isinstance(self.estimator, Estimator) else time_ns

    @property
    def has_started(self) -> bool:
        """Whether estimates were ever given; the estimator may have begun anew since."""
        return self.estimator.event_counts[EventKind.INITIALISED] > 0

    @property
    def first_stamp_ns(self) -> int:
        """Stamp of the first message, from which outages count."""
        return self._filter.first_ns or 0

    def judged_track(self) -> tuple[JudgedTrack, int]:
        """Return the causal track with the held-out fixes, and the stamp from which its times count.

        Raises:
            EstimatorError: there is no track: the estimator never started, or `keep_track` was not asked for.
        """
        if not self._kept:
            raise EstimatorError(f"there is no track to show: {self.estimator.waiting_for}")
        start_ns = self._kept[0][0]
        rows = np.array([(stamp - start_ns, *rest) for stamp, *rest in self._kept], dtype=np.float64)
        judged = self.causal.judgements
        track = JudgedTrack(
            time_s=rows[:, 0] * 1e-9,
            positions=rows[:, 1:3],
            sigma_m=np.sqrt(rows[:, 3]),
            fix_time_s=np.array([(j.stamp_ns - start_ns) * 1e-9 for j in judged]),
            fixes=np.array([j.position[:2] for j in judged]).reshape(-1, 2),
            errors_m=np.array([np.hypot(j.error[0], j.error[1]) for j in judged]),
            in_outage=np.array([j.in_outage for j in judged], dtype=np.bool_),
        )
        return track, start_ns


def _held_out_record(one: Judgement) -> MeasurementRecord:
    return MeasurementRecord(one.stamp_ns, one.sensor, Outcome.IGNORED, one.nees, 3, p_W_P=one.position)
