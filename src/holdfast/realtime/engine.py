"""`RealtimeEstimator`: the IMU path in the caller's process, the optimiser in another one.

The IMU path takes no lock, waits for nothing, and goes on whatever becomes of the optimiser.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from time import monotonic, sleep
from types import TracebackType
from typing import Self

from holdfast.arguments import check_count, check_flag, check_seconds, check_time
from holdfast.config.model import Config, check_config, check_sensor
from holdfast.errors import EstimatorError
from holdfast.estimator.health import HealthMonitor
from holdfast.estimator.imu_path import ImuPath, Received
from holdfast.estimator.intake import Intake
from holdfast.event_log import EventLog
from holdfast.events import Event, EventKind, Health, HealthReport, Outcome
from holdfast.geometry.earth import Geodetic, LocalFrame, check_datum
from holdfast.integrity.learnt_snapshot import LearntSnapshot, check_learnt
from holdfast.kernel.imu_path import HAS_NEWS
from holdfast.measured_fields import no_message
from holdfast.messages import ImuSample, JointAngle, Message
from holdfast.realtime.event_log import EngineLog
from holdfast.realtime.follower import StateFollower
from holdfast.realtime.layout import Board
from holdfast.realtime.memory import Word
from holdfast.realtime.overload import Overload
from holdfast.realtime.placement import place_caller
from holdfast.realtime.records import Records, Request
from holdfast.realtime.supervisor import START_S, Supervisor
from holdfast.realtime.worker import Settings
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.registry import MessageKinds, inputs_of
from holdfast.state import NOTHING, OptimisedState, Output

FLUSH_S = 30.0
SPARE_ROWS = 64  # of the ring of measurements, kept for requests
WAITING_NS = 30_000_000_000  # of samples before the start


class RealtimeEstimator(Intake):
    """Fuses the sensors of one machine while it works; a context manager.

    Args:
        config: what the sensors are, where they sit, and how the estimator is to behave; its section `realtime` says
            how the two processes share the machine.
        in_step: wait after each message until the optimiser has answered, so that the results are those of `Estimator`
            to the bit; for tests.
        learnt: what was learnt of the sensors before.

    Raises:
        ConfigError: an argument is of another type, or the machine does not allow what its section `realtime` asks for.
    """

    def __init__(self, config: Config, *, in_step: bool = False, learnt: LearntSnapshot | None = None) -> None:
        check_config(config)
        check_flag("in_step", in_step)
        learnt = check_learnt(learnt)
        cores = place_caller(config.realtime)
        self.config = config
        self._in_step = in_step
        self._imu, self._inputs = config.imu_name, frozenset(inputs_of(config))
        self._kinds = MessageKinds(config)
        self._log = EventLog(self._imu)
        self._reports = EngineLog(self._log)
        self._overload = Overload(config, self._log)
        self._buffer = ImuBuffer(config.imu)
        self._records = Records(config)
        self._monitor = HealthMonitor(config)
        self._board = Board(self._records)
        self._samples, self._requests = self._board.samples, self._board.requests
        self._path = ImuPath(config, self._buffer, self._log, learnt.joint)
        self._states = StateFollower(config, self._board, self._records, self._path, self._buffer)
        self._answer, self._answering = self._path.answer, "" if in_step else self._imu
        self._is_full = self._is_closed = False
        self._fault_version: int | None = None  # of the states when the optimiser failed, until a successor publishes
        self._supervisor = Supervisor(
            Settings(config, in_step, cores, learnt), self._board, self._reports.receive, self._receive_fault
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Let the optimiser take in what is left, and end it; its log can still be read."""
        if not self._is_closed:
            self._is_closed = True
            self._supervisor.stop()
            self._states.take()
            self._answering = ""
            self._states.release()
            self._board.close()

    # --- what it knows ------------------------------------------------------------------------------------------------

    @property
    def datum(self) -> Geodetic | None:
        """Origin of W on the ellipsoid, or None until the first accepted fix."""
        return self._states.world.datum

    @property
    def world(self) -> LocalFrame | None:
        """The world frame W about the datum, or None until there is one."""
        return self._states.world.frame

    @property
    def initialised(self) -> bool:
        """Whether estimates are being given."""
        return self._path.is_running

    @property
    def waiting_for(self) -> str:
        """What keeps the estimator from starting."""
        return self._log_now().waiting_for

    @property
    def health(self) -> Health:
        """How the estimator is now, in one word."""
        newest = self._states.newest
        if newest is None or not self._path.is_running:
            return Health.INITIALISING
        if self._fault_version == self._states.seen:
            return Health.OPTIMISER_RESET  # no successor has published yet
        self._monitor.restore(newest.health)
        return self._monitor.assess(
            self._buffer.latest_ns,
            has_imu=self._path.has_imu,
            is_lost=newest.is_lost,
            lost=newest.lost,
        )

    @property
    def counts(self) -> Counter[tuple[str, Outcome]]:
        """How many measurements of each sensor had which outcome; those that still wait are not counted yet."""
        self._path.count()
        return self._log_now().counts

    @property
    def event_counts(self) -> Counter[EventKind]:
        """How many events of each kind there were."""
        return self._log_now().event_counts

    @property
    def events(self) -> list[Event]:
        """The events that have not been taken."""
        return self._path.clock.events(self._log_now().events)

    @property
    def newest_state(self) -> OptimisedState | None:
        """The optimised state from which the IMU path goes on."""
        newest = self._states.newest
        return None if newest is None else self._path.clock.optimised(newest.state)

    @property
    def optimiser_pid(self) -> int | None:
        """The other process, None while there is none."""
        return self._supervisor.pid

    @property
    def optimiser_cpu_s(self) -> float:
        """Processor time of the other process, as of its last report [s]."""
        return self._log_now().optimiser_cpu_s

    def health_report(self) -> HealthReport:
        """Return the health now with what it rests on."""
        stamp_ns = self._path.clock.stamp(self._buffer.latest_ns)
        return replace(self._monitor.report(self._buffer.latest_ns, self.health), stamp_ns=stamp_ns)

    def noise(self, sensor: str) -> float:
        """Return how many times larger the noise of a sensor is than it claims, as its innovations show.

        Raises:
            ConfigError: the sensor is not in the configuration.
        """
        check_sensor(self.config, sensor)
        return self._monitor.noise(sensor)

    def learnt(self) -> LearntSnapshot:
        """Return what was learnt of the sensors, some seconds ago; once closed, in the end. A reset forgets it."""
        self._log_now()
        return self._supervisor.learnt.with_joint(self._path.learnt())

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        return self._path.clock.events(self._log_now().take_events())

    def take_update_times(self) -> list[int]:
        """Return how long each update since the last call took [ns]."""
        return self._log_now().take_update_times()

    def wait_until_ready(self, timeout_s: float = START_S) -> None:
        """Wait until the optimiser process has come up; not needed, because what comes before waits for it.

        Raises:
            ConfigError: the timeout is no time.
            EstimatorError: it does not come up, or the estimator is closed.
        """
        check_seconds("timeout_s", timeout_s)
        self._check_open()
        self._wait(lambda: self._board.words[Word.HEARTBEAT] > 0, timeout_s, "come up")

    def flush(self, timeout_s: float = FLUSH_S) -> Output:
        """Wait until the optimiser has taken in all that came, and return what it led to.

        Raises:
            ConfigError: the timeout is no time.
            EstimatorError: it does not answer, or the estimator is closed.
        """
        check_seconds("timeout_s", timeout_s)
        self._check_open()
        return self._path.clock.output(self._flush(timeout_s))

    def _flush(self, timeout_s: float = FLUSH_S) -> Output:
        words, samples, requests = self._board.words, self._samples, self._requests
        self._supervisor.wake()
        self._wait(
            lambda: words[Word.SAMPLES] >= samples.written and words[Word.REQUESTS] >= requests.written,
            timeout_s,
            "answer",
        )
        optimised = self._states.take() if self._states.has_new else None
        return Output(None, optimised, self._log_now().take_smoothed())

    def _wait(self, is_done: Callable[[], bool], timeout_s: float, what: str) -> None:
        until_s = monotonic() + timeout_s
        while not is_done():
            if monotonic() > until_s:
                fault = self._log_now().last_fault
                reason = f"the optimiser process does not {what} within {timeout_s:g} s"
                raise EstimatorError(f"{reason}: {fault}" if fault else reason)
            self._log_now()
            sleep(20e-6 if self._in_step else 1e-3)

    # --- what comes in ------------------------------------------------------------------------------------------------

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival; always from the same thread.

        Returns:
            The estimate at a sample of the IMU, and the optimised state if a new one was taken in.

        Raises:
            ConfigError: the sensor is not in the configuration.
            MessageError: it is no message, or one of another kind than the sensor's.
            EstimatorError: the estimator is closed.
        """
        try:
            name = message.sensor
        except AttributeError:
            raise no_message(message) from None
        if name == self._answering and isinstance(message, ImuSample):
            readings = message.specific_force, message.angular_velocity
            return self._answer(message.stamp_ns, message.arrival_ns, *readings) or self._finish(message)
        self._check_open()
        if name == self._imu and isinstance(message, ImuSample):
            return self._path.clock.output(self._give(None, self._path.process(message)))
        self._kinds.check(message)
        if not self._overload.admits(name, message.arrival_ns, self._buffer.latest_ns):
            return self._path.clock.output(self._take_new())
        return self._path.clock.output(self._process_other(self._path.clock.read(message)))

    def _process_other(self, message: Message) -> Output:
        name = message.sensor
        if isinstance(message, ImuSample | JointAngle) and self._path.serves_chassis(name):
            self._path.add_to_chassis(message)
        if name in self._inputs:
            self._ask(self._path.corrected(message))
            return self._flush() if self._in_step else self._take_new()
        if not self._path.serves_chassis(name):
            self._log.count(name, Outcome.IGNORED)
        return self._take_new()

    def _take_new(self) -> Output:
        if not self._states.has_new:
            return NOTHING
        return Output(None, self._states.take(), self._log_now().take_smoothed())

    def room(self, sensor: str, arrival_ns: int) -> int | None:
        """Return how many measurements of a sensor will be taken in now, None if there is no limit.

        Who knows of more leaves out the oldest and says so by `shed`, before work is spent on them.

        Raises:
            ConfigError: the sensor is not in the configuration, or the arrival is no time.
        """
        check_sensor(self.config, sensor)
        check_time("arrival_ns", arrival_ns)
        return self._overload.room(sensor, arrival_ns)

    def shed(self, sensor: str, number: int, arrival_ns: int) -> None:
        """Count measurements that were left out because there was no `room` for them.

        Raises:
            ConfigError: the sensor is none of the configuration or an IMU, of which nothing may be left out; or the
                number is not 1 or more, or the arrival no time.
        """
        self._overload.check(sensor)
        check_count("number", number, 1)
        check_time("arrival_ns", arrival_ns)
        self._overload.shed(sensor, number, arrival_ns, self._buffer.latest_ns)

    def reset(self) -> None:
        """Forget the state and what was learnt, and begin anew; W stays where it is.

        Raises:
            EstimatorError: the estimator is closed.
        """
        self._check_open()
        self._path.forget()
        self._begin_anew(None)

    def set_datum(self, datum: Geodetic) -> None:
        """Put the origin of W somewhere else and begin anew: no pose of before compares with one of now.

        Raises:
            ConfigError: it is no position on the earth; nothing is changed.
            EstimatorError: the estimator is closed.
        """
        check_datum(datum)
        self._check_open()
        self._states.world.place(datum)
        self._begin_anew(datum)

    def _check_open(self) -> None:
        if self._is_closed:
            raise EstimatorError("the estimator is closed")

    def _finish(self, sample: ImuSample) -> Output:
        """Do what is left to do at a sample that the path has not answered."""
        path, optimised = self._path, None
        if path.flags == HAS_NEWS:
            optimised = self._states.take()
            answer = path.answer(sample.stamp_ns, sample.arrival_ns, sample.specific_force, sample.angular_velocity)
            if answer is not None:
                return answer._replace(optimised=optimised, smoothed=self._reports.take_smoothed())
        return path.clock.output(self._give(optimised, path.finish(sample)))

    def _give(self, optimised: OptimisedState | None, received: Received | None) -> Output:
        """Return what a sample led to, and pass on one that the path has not passed on itself."""
        states = self._states
        if received is None:
            return NOTHING if optimised is None else Output(None, optimised)
        if not received.is_usual:
            self._pass_on(received)
        estimate = received.estimate
        if not received.is_sound:
            self.reset()
            return NOTHING
        if self._in_step:
            return self._flush()._replace(estimate=estimate, base=received.base)
        if estimate is None:
            self._buffer.forget_before(self._buffer.latest_ns - WAITING_NS)
        elif estimate.stamp_ns > states.rescue_ns:
            states.rescue()
        return Output(estimate, optimised, self._reports.take_smoothed(), received.base)

    def _pass_on(self, received: Received) -> None:
        if received.begins_anew:
            self._states.begin_anew()
        self._samples.push(self._records.pack_sample(self._states.epoch, received.sample))

    def _ask(self, request: Request) -> None:
        waiting = self._requests.written - self._board.words[Word.BEGUN]
        if request is not None and not isinstance(request, Geodetic) and waiting >= self._requests.rows - SPARE_ROWS:
            self._log.count(request.sensor, Outcome.LATE)
            if not self._is_full:
                reason = f"the optimiser is {waiting} measurements behind: those that follow are lost"
                self._log.report(EventKind.LATE, request.stamp_ns, request.sensor, reason)
            self._is_full = True
        else:
            self._is_full = False
            self._requests.push(self._records.pack_request(self._states.epoch, self._samples.written, request))
            self._supervisor.wake()

    def _begin_anew(self, datum: Geodetic | None) -> None:
        self._path.stop()
        self._states.begin_anew()
        self._ask(datum)
        if self._in_step:
            self._flush()

    def _log_now(self) -> EngineLog:
        """Return the log of both processes with what has come until now."""
        if not self._is_closed:
            self._supervisor.collect()
        return self._reports

    def _receive_fault(self, why: str) -> None:
        """Note, in the thread of the supervisor, why an optimiser has ended."""
        words = self._board.words
        lost = words[Word.WAITING] + words[Word.BEGUN] - words[Word.REQUESTS]
        self._reports.receive_fault(self._buffer.latest_ns, why, lost)
        self._fault_version = self._states.version
