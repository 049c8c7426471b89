"""A filter as a comparison system: a message in, an estimate at every IMU sample out."""

from collections.abc import Callable
from typing import Generic

import numpy as np

from holdfast.baselines.baseline import IDENTITY
from holdfast.baselines.intake import Intake, Measurement, PositionFix
from holdfast.baselines.propagation import Propagation, Tuning
from holdfast.baselines.rewind import B, Filter, Rewinder
from holdfast.baselines.start import StandstillStart, Start
from holdfast.config.model import Config
from holdfast.events import EventKind, Outcome
from holdfast.messages import ImuSample, Message
from holdfast.sensors.imu import ImuBuffer
from holdfast.state import Estimate, OptimisedState, Output


class FilterSystem(Generic[B]):
    """Runs a filter on the messages of one machine; deterministic, as the estimator is.

    The odometry frame O of a filter is W: every correction is a step of its output.

    Args:
        config: of the machine; the same file as the estimator's.
        intake: checks and converts the measurements.
        make: makes the filter and its first belief.
        uses_odometry: whether the odometry corrects the filter, beside the positions.
        tuning: of this filter.
    """

    def __init__(
        self,
        config: Config,
        intake: Intake,
        make: Callable[[Tuning, Intake, Start], tuple[Filter[B], B]],
        uses_odometry: bool,
        tuning: Tuning,
    ) -> None:
        self._config = config
        self._intake = intake
        self._make = make
        self._odometry_name = intake.odometry.name if uses_odometry and intake.odometry is not None else None
        self._tuning = tuning
        self._imu_name = config.imu_name
        self._buffer = ImuBuffer(config.imu)
        self._starter = StandstillStart(config, intake, self._buffer)
        self._rewinder: Rewinder[B] | None = None
        self._belief: B
        self._waiting: list[Measurement] = []

    @property
    def initialised(self) -> bool:
        """Whether estimates are being given."""
        return self._rewinder is not None

    @property
    def waiting_for(self) -> str:
        """What keeps it from starting."""
        return self._starter.reason

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival."""
        if isinstance(message, ImuSample) and message.sensor == self._imu_name:
            return self._process_imu(message)
        if message.sensor in self._intake.positions:
            return self._enqueue(self._intake.position(message))
        if message.sensor == self._odometry_name:
            return self._enqueue(self._intake.track_pose(message))
        if self._starter.takes_heading(message) and not self.initialised:
            self._starter.add_heading(message)
        else:
            self._intake.ignore(message)
        return Output()

    def _process_imu(self, sample: ImuSample) -> Output:
        buffer = self._buffer
        outcome = buffer.check(sample)
        self._intake.counts[sample.sensor, outcome] += 1
        if outcome is not Outcome.USED:
            return Output()
        if sample.stamp_ns + buffer.offset_ns < buffer.latest_ns:
            self._start_over(sample)
        before_ns = buffer.latest_ns
        has_step, line_since_ns = buffer.add(sample)
        rewinder = self._rewinder
        if rewinder is None:
            return Output()
        stamp, belief = buffer.latest_ns, self._belief
        if line_since_ns is not None:
            belief = self._belief = rewinder.newest.copy()  # samples that looked good were a straight line
            rewinder.carry(belief, stamp)
        elif not has_step:
            rewinder.coast(belief, stamp)
        else:
            rewinder.step(belief, *buffer.steps(before_ns, stamp))
            belief.stamp_ns = stamp
        rate = sample.angular_velocity - belief.bias_gyro
        covariance = belief.nav_covariance()
        estimate = Estimate.of(stamp, belief.nav, IDENTITY, belief.bias, covariance, rate, has_step)
        ready = [one for one in self._waiting if one.stamp_ns <= stamp]
        return self._update(rewinder, ready, estimate) if ready else Output(estimate)

    def _update(self, rewinder: Rewinder[B], ready: list[Measurement], estimate: Estimate) -> Output:
        self._waiting = [one for one in self._waiting if one.stamp_ns > estimate.stamp_ns]
        for measurement, outcome in zip(ready, rewinder.take(ready), strict=True):
            self._intake.counts[measurement.sensor, outcome] += 1
            if outcome is not Outcome.USED:
                self._intake.report(EventKind.REJECTED, measurement.stamp_ns, measurement.sensor, outcome)
        newest = rewinder.newest
        self._belief = newest.copy()
        rewinder.carry(self._belief, estimate.stamp_ns)
        self._buffer.forget_before(rewinder.oldest_ns)
        rate = self._buffer.angular_velocity(newest.stamp_ns) - newest.bias_gyro
        return Output(estimate, OptimisedState(newest.stamp_ns, newest.nav, newest.bias, newest.covariance(), rate))

    def _enqueue(self, measurement: Measurement | None) -> Output:
        if measurement is None:
            return Output()
        if self._rewinder is None:
            self._intake.counts[measurement.sensor, Outcome.BEFORE_START] += 1
            start = self._starter.add_fix(measurement.content) if isinstance(measurement.content, PositionFix) else None
            return Output() if start is None else self._begin(start)
        if measurement.stamp_ns < self._rewinder.oldest_ns:
            self._intake.counts[measurement.sensor, Outcome.LATE] += 1
            self._intake.report(EventKind.LATE, measurement.stamp_ns, measurement.sensor, "left the buffer of states")
        else:
            self._waiting.append(measurement)
        return Output()

    def _begin(self, start: Start) -> Output:
        model = Propagation(self._config, self._intake.gravity, self._tuning)
        filter_, belief = self._make(self._tuning, self._intake, start)
        lag_ns = round(self._config.graph.lag_s * 1e9)
        self._rewinder = Rewinder(filter_, self._buffer, model, belief, lag_ns)
        self._belief = belief.copy()
        self._intake.report(EventKind.INITIALISED, start.stamp_ns, "", self._starter.reason)
        return Output(None, OptimisedState(start.stamp_ns, start.nav, start.bias, start.covariance, np.zeros(3)))

    def _start_over(self, sample: ImuSample) -> None:
        """Begin anew after the IMU's clock has gone back for good."""
        self._intake.report(EventKind.CLOCK_STEP, sample.stamp_ns, sample.sensor, "the clock has gone back")
        self._buffer.clear()
        self._intake.forget_stamps()
        self._waiting.clear()
        self._rewinder = None
        self._starter = StandstillStart(self._config, self._intake, self._buffer)
