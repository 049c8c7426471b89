"""Drives the estimator with a stream of messages, and measures how long each took."""

from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from time import perf_counter, perf_counter_ns, sleep

from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator, Output
from holdfast.geometry.earth import LocalFrame
from holdfast.messages import GnssFix, ImuSample, Message
from holdfast.replay.held_out import HeldOutJudge, HoldOut, HoldOutFilter
from holdfast.replay.outputs import Outputs


@dataclass(slots=True)
class Timing:
    """How long the estimator took: `imu_ns` per IMU sample without, `update_ns` per message with an optimisation."""

    imu_ns: "array[int]" = field(default_factory=lambda: array("q"))
    update_ns: "array[int]" = field(default_factory=lambda: array("q"))
    wall_s: float = 0.0
    recorded_s: float = 0.0


class Replay:
    """One replay of one stream; `run` may be interrupted, what was done until then stays valid."""

    def __init__(self, config: Config, outputs: Outputs | None = None, hold_out: Iterable[HoldOut] = ()) -> None:
        self.estimator = Estimator(config)
        self.timing = Timing()
        self.causal = HeldOutJudge(config)
        self.smoothed = HeldOutJudge(config)
        self._filter = HoldOutFilter(hold_out, config)
        self._outputs = outputs
        self._frame: LocalFrame | None = None

    def run(
        self, messages: Iterable[Message], rate: float | None = None, progress: Callable[[int], None] | None = None
    ) -> None:
        """Process all messages, as fast as possible or at `rate` times the pace of their arrival.

        Args:
            messages: in the order of arrival.
            rate: 1.0 is the pace of the recording.
            progress: called with the arrival [ns] every now and then.
        """
        began, first_ns, last_ns = perf_counter(), 0, 0
        try:
            for count, message in enumerate(self._filter.split(messages)):
                last_ns = message.arrival_ns
                first_ns = first_ns or last_ns
                if rate is not None:
                    ahead_s = (last_ns - first_ns) * 1e-9 / rate - (perf_counter() - began)
                    if ahead_s > 0.0:
                        sleep(ahead_s)
                self._process(message)
                if progress is not None and count % 500 == 0:
                    progress(last_ns)
        finally:
            self.timing.wall_s = perf_counter() - began
            self.timing.recorded_s = (last_ns - first_ns) * 1e-9
            self._judge(Output())

    def _process(self, message: Message) -> None:
        began_ns = perf_counter_ns()
        output = self.estimator.process(message)
        took_ns = perf_counter_ns() - began_ns
        if output.optimised is not None:
            self.timing.update_ns.append(took_ns)
        elif isinstance(message, ImuSample):
            self.timing.imu_ns.append(took_ns)
        if self._outputs is not None:
            self._outputs.write(output)
            self._outputs.diagnose(self.estimator, message.arrival_ns)
            if self.estimator.events:
                self._outputs.write_events(self.estimator.take_events())
        self._judge(output)

    def _judge(self, output: Output) -> None:
        while self._filter.held:
            message, in_outage = self._filter.held.popleft()
            if isinstance(message, GnssFix):
                self.causal.add_fix(message, in_outage)
                self.smoothed.add_fix(message, in_outage)
        frame = self._frame = self._frame or self.estimator.world
        if frame is None:
            return
        if output.estimate is not None:
            self.causal.add_estimate(output.estimate, frame)
        if output.optimised is not None:
            self.causal.add_optimised(output.optimised, frame)
        for stamp_ns, nav in output.smoothed:
            self.smoothed.add_smoothed(stamp_ns, nav, frame)
