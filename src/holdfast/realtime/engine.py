"""`RealtimeEstimator`: the IMU path in the caller's process, the optimiser in another one.

The IMU path takes no lock, waits for nothing, and goes on whatever becomes of the optimiser.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from time import monotonic, sleep, time_ns
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from holdfast.config.model import Config
from holdfast.errors import ConfigError, EstimatorError
from holdfast.estimator.health import HealthMonitor
from holdfast.estimator.imu_path import ImuPath
from holdfast.estimator.journal import Journal
from holdfast.estimator.optimiser import Measurement
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.messages import FixStatus, GnssFix, Heading, ImuSample, JointAngle, LidarPose, Message
from holdfast.realtime.chronicle import Chronicle
from holdfast.realtime.layout import Board
from holdfast.realtime.memory import Word
from holdfast.realtime.placement import place_caller
from holdfast.realtime.records import Published, Request, pack_request, pack_sample
from holdfast.realtime.rehearsal import Rehearsal
from holdfast.realtime.supervisor import START_S, Supervisor
from holdfast.realtime.worker import Settings
from holdfast.sensors.imu import ImuBuffer
from holdfast.state import NOTHING, Event, EventKind, Health, HealthReport, OptimisedState, Outcome, Output

FLUSH_S = 30.0
LEAVE = 2  # for so many samples a new state is left to calls that are in less of a hurry
SPARE_ROWS = 64  # of the ring of measurements, kept for requests
KEPT_NS = 1_000_000_000  # of samples before the newest optimised state
WAITING_NS = 30_000_000_000  # of samples before the start
RESCUE_S = 5.0  # without an optimised state for so long, or three node intervals, the propagated one takes its place


class RealtimeEstimator:
    """Fuses the sensors of one machine while it works; a context manager.

    Args:
        config: what the sensors are, where they sit, and how the estimator is to behave; its section `realtime` says
            how the two processes share the machine.
        in_step: wait after each message until the optimiser has answered, so that the results are those of `Estimator`
            to the bit; for tests.

    Raises:
        ConfigError: the machine does not allow what the section `realtime` asks for.
    """

    def __init__(self, config: Config, *, in_step: bool = False) -> None:
        cores = place_caller(config.realtime)
        self.config = config
        self._in_step = in_step
        self._journal = Journal()
        self._chronicle = Chronicle(self._journal)
        self._buffer = ImuBuffer(config.sensors.imu)
        self._path = ImuPath(config, self._buffer, self._journal)
        self._rehearsal = None if in_step else Rehearsal(config)
        self._monitor = HealthMonitor(config)
        self._sensors = frozenset(name for name, sensor in config.sensors if sensor is not None)
        self._board = Board()
        self._slot, self._samples, self._requests = self._board.published, self._board.samples, self._board.requests
        self._epoch = self._life = self._recoveries = self._seen = self._left = self._anchor_ns = 0
        self._rescue_ns = round(max(RESCUE_S, 3.0 * config.graph.max_node_interval_s) * 1e9)
        self._newest: Published | None = None
        self._world: LocalFrame | None = None
        self._is_full = self._is_rescued = self._is_closed = False
        self._fault_version: int | None = None  # of the slot when the optimiser failed, until a successor publishes
        self._supervisor = Supervisor(
            Settings(config, in_step, cores), self._board, self._chronicle.hear, self._hear_fault
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Let the optimiser take in what is left, and end it; what it told can still be asked for."""
        if not self._is_closed:
            self._is_closed = True
            self._supervisor.stop()
            self._look()
            self._board.close()

    # --- what a program asks -----------------------------------------------------------------------------------------

    @property
    def datum(self) -> Geodetic | None:
        """Origin of W on the ellipsoid, or None until the first accepted fix."""
        return None if self._world is None else self._world.datum

    @property
    def world(self) -> LocalFrame | None:
        """The world frame W about the datum, or None until there is one."""
        return self._world

    @property
    def initialised(self) -> bool:
        """Whether estimates are being given."""
        return self._path.predictor is not None

    @property
    def waiting_for(self) -> str:
        """What keeps the estimator from starting."""
        return self._told().waiting_for

    @property
    def health(self) -> Health:
        """How the estimator is now, in one word."""
        newest = self._newest
        if newest is None or self._path.predictor is None:
            return Health.INITIALISING
        if self._fault_version == self._seen:
            return Health.OPTIMISER_RESET  # no successor has published yet
        self._monitor.restore(newest.health)
        return self._monitor.assess(
            self._buffer.latest_ns,
            hears_imu=self._path.hears_imu,
            is_lost=bool(newest.lost & 4),
            antenna_lost=bool(newest.lost & 3),
        )

    @property
    def counts(self) -> Counter[tuple[str, Outcome]]:
        """How many measurements of each sensor had which outcome; those that still wait are not counted yet."""
        return self._told().counts

    @property
    def event_counts(self) -> Counter[EventKind]:
        """How many events of each kind there were."""
        return self._told().event_counts

    @property
    def events(self) -> list[Event]:
        """The events that have not been taken."""
        return self._told().events

    @property
    def newest_state(self) -> OptimisedState | None:
        """The optimised state from which the IMU path goes on."""
        return None if self._newest is None else self._newest.state

    @property
    def optimiser_pid(self) -> int | None:
        """The other process, None while there is none."""
        return self._supervisor.pid

    @property
    def optimiser_cpu_s(self) -> float:
        """Processor time of the other process, as of its last report [s]."""
        return self._told().optimiser_cpu_s

    def health_report(self) -> HealthReport:
        """Return the health now with what it rests on."""
        return self._monitor.report(self._buffer.latest_ns, self.health)

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        return self._told().take_events()

    def take_update_times(self) -> list[int]:
        """Return how long each update since the last call took [ns]."""
        return self._told().take_update_times()

    def wait_until_ready(self, timeout_s: float = START_S) -> None:
        """Wait until the optimiser process has come up; not needed, because what comes before waits for it.

        Raises:
            EstimatorError: it does not come up.
        """
        self._wait(lambda: self._board.words[Word.HEARTBEAT] > 0, timeout_s, "come up")

    def flush(self, timeout_s: float = FLUSH_S) -> Output:
        """Wait until the optimiser has taken in all that came, and return what it led to.

        Raises:
            EstimatorError: it does not answer.
        """
        words, samples, requests = self._board.words, self._samples, self._requests
        self._supervisor.wake()
        self._wait(
            lambda: words[Word.SAMPLES] >= samples.written and words[Word.REQUESTS] >= requests.written,
            timeout_s,
            "answer",
        )
        optimised = self._look() if self._slot.version != self._seen else None
        return Output(None, optimised, self._told().take_smoothed())

    def _wait(self, is_done: Callable[[], bool], timeout_s: float, what: str) -> None:
        until_s = monotonic() + timeout_s
        while not is_done():
            if monotonic() > until_s:
                fault = self._told().last_fault
                reason = f"the optimiser process does not {what} within {timeout_s:g} s"
                raise EstimatorError(f"{reason}: {fault}" if fault else reason)
            self._told()
            sleep(20e-6 if self._in_step else 1e-3)

    # --- what a program tells ----------------------------------------------------------------------------------------

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival; always from the same thread.

        Returns:
            The estimate at a sample of the IMU, and the optimised state if a new one was taken in.

        Raises:
            ConfigError: the sensor is not in the configuration.
            EstimatorError: the estimator is closed.
        """
        if self._is_closed:
            raise EstimatorError("the estimator is closed")
        if isinstance(message, ImuSample) and message.sensor != "base_imu":
            return self._process_imu(message)
        if isinstance(message, ImuSample | JointAngle):
            self._path.add_to_base(message)
            if self._rehearsal is not None:
                self._rehearsal.add_to_base(message)
            return self._take_new()
        return self._process_measurement(message)

    @property
    def refresh_in_s(self) -> float | None:
        """In how many seconds `refresh` is best called [s]; None if the next sample needs no further call."""
        return None if self._rehearsal is None else self._rehearsal.due_in_s

    def refresh(self) -> Output:
        """Get ready for the next sample of the IMU; for a program that has nothing else to do until then.

        Takes in a new optimised state, if there is one, and fetches what the IMU path needs into the processor's
        caches, so that the sample is answered faster. Takes as long as an answer itself: call it half a millisecond
        before the sample is due, when `refresh_in_s` says so. Without it, new states are taken in by the messages that
        are not samples of the IMU, or else by the third sample.
        """
        output = self._take_new()
        if self._rehearsal is not None:
            self._rehearsal.run(self._newest)
        return output

    def _take_new(self) -> Output:
        if self._slot.version == self._seen:
            return NOTHING
        return Output(None, self._look(), self._told().take_smoothed())

    def add_imu(
        self, stamp_ns: int, angular_velocity: ArrayLike, specific_force: ArrayLike, arrival_ns: int | None = None
    ) -> Output:
        """Take in a sample of the IMU: (3,) [rad/s] and (3,) [m/s^2], as in `ImuSample`.

        Here as in what follows, `arrival_ns` is the time at which it came; now, if it is left out.
        """
        rate, force = np.asarray(angular_velocity, dtype=np.float64), np.asarray(specific_force, dtype=np.float64)
        return self.process(ImuSample(stamp_ns, arrival_ns or time_ns(), "imu", rate, force))

    def add_gnss(
        self,
        stamp_ns: int,
        latitude_deg: float,
        longitude_deg: float,
        altitude_m: float,
        *,
        covariance: ArrayLike | None = None,
        status: FixStatus = FixStatus.GBAS,
        sensor: str = "gnss",
        arrival_ns: int | None = None,
    ) -> Output:
        """Take in a fix of the antenna `gnss` or `gnss_right`, with its covariance (3, 3) [m^2], as in `GnssFix`."""
        place = latitude_deg, longitude_deg, altitude_m
        known = None if covariance is None else np.asarray(covariance, dtype=np.float64).reshape(3, 3)
        return self.process(GnssFix(stamp_ns, arrival_ns or time_ns(), sensor, *place, known, status))

    def add_heading(
        self, stamp_ns: int, yaw_rad: float, sigma_rad: float | None = None, arrival_ns: int | None = None
    ) -> Output:
        """Take in a heading: 0 is east, counter-clockwise, as in `Heading`."""
        return self.process(Heading(stamp_ns, arrival_ns or time_ns(), "heading", yaw_rad, sigma_rad))

    def add_lidar(
        self,
        stamp_ns: int,
        position: ArrayLike,
        quaternion: ArrayLike,
        *,
        covariance: ArrayLike | None = None,
        arrival_ns: int | None = None,
    ) -> Output:
        """Take in a pose of the lidar's odometry: (3,) [m], (4,) x, y, z, w, covariance (6, 6), as in `LidarPose`."""
        pose = np.asarray(position, dtype=np.float64), np.asarray(quaternion, dtype=np.float64)
        known = None if covariance is None else np.asarray(covariance, dtype=np.float64).reshape(6, 6)
        return self.process(LidarPose(stamp_ns, arrival_ns or time_ns(), "lidar", *pose, known))

    def add_joint(self, stamp_ns: int, angle_rad: float, arrival_ns: int | None = None) -> Output:
        """Take in the angle of the turn joint, as in `JointAngle`."""
        return self.process(JointAngle(stamp_ns, arrival_ns or time_ns(), "joint", angle_rad))

    def add_base_imu(
        self, stamp_ns: int, angular_velocity: ArrayLike, specific_force: ArrayLike, arrival_ns: int | None = None
    ) -> Output:
        """Take in a sample of the IMU on the chassis, as `add_imu`."""
        rate, force = np.asarray(angular_velocity, dtype=np.float64), np.asarray(specific_force, dtype=np.float64)
        return self.process(ImuSample(stamp_ns, arrival_ns or time_ns(), "base_imu", rate, force))

    def reset(self) -> None:
        """Forget the state and begin anew, as at power-on; W stays where it is."""
        self._begin_anew(None)

    def set_datum(self, datum: Geodetic) -> None:
        """Put the origin of W somewhere else and begin anew: no pose of before compares with one of now."""
        self._world = LocalFrame(datum)
        self._begin_anew(datum)

    def _process_imu(self, sample: ImuSample) -> Output:
        self._left += self._slot.version != self._seen
        is_time = self._left > LEAVE or (self._left > 0 and self._path.predictor is None)
        optimised = self._look() if is_time else None
        heard = self._path.hear(sample)
        if heard is None:
            return NOTHING if optimised is None else Output(None, optimised)
        if heard.has_stepped_back:
            self._forget()
        estimate = self._path.propagate(heard)
        base = None if estimate is None else self._path.chassis(estimate)
        self._samples.push(pack_sample(self._epoch, sample))
        if self._rehearsal is None:
            return self.flush()._replace(estimate=estimate, base=base)
        self._rehearsal.note(sample)
        if estimate is None:
            self._buffer.forget_before(self._buffer.latest_ns - WAITING_NS)
        elif estimate.stamp_ns - self._anchor_ns > self._rescue_ns:
            self._rescue()
        return Output(estimate, optimised, self._chronicle.take_smoothed(), base)

    def _process_measurement(self, message: Measurement) -> Output:
        if message.sensor not in self._sensors:
            raise ConfigError(f"sensors.{message.sensor}: not in the configuration, but a measurement of it came")
        self._ask(message)
        return self.flush() if self._in_step else self._take_new()

    def _ask(self, request: Request) -> None:
        waiting = self._requests.written - self._board.words[Word.BEGUN]
        if isinstance(request, GnssFix | Heading | LidarPose) and waiting >= self._requests.rows - SPARE_ROWS:
            self._journal.count(request.sensor, Outcome.LATE, 1)
            if not self._is_full:
                reason = f"the optimiser is {waiting} measurements behind: those that follow are lost"
                self._journal.tell(EventKind.LATE, request.stamp_ns, request.sensor, reason)
            self._is_full = True
        else:
            self._is_full = False
            self._requests.push(pack_request(self._epoch, self._samples.written, request))
            self._supervisor.wake()

    def _begin_anew(self, datum: Geodetic | None) -> None:
        self._path.stop()
        self._forget()
        self._ask(datum)
        if self._in_step:
            self.flush()

    def _forget(self) -> None:
        self._epoch, self._newest = self._epoch + 1, None

    # --- what the optimiser tells ------------------------------------------------------------------------------------

    def _look(self) -> OptimisedState | None:
        """Take in the newest optimised state."""
        found = self._slot.read()
        if found is None:
            return None
        self._left, (self._seen, record) = 0, found
        newest = Published.unpack(record)
        if newest.epoch != self._epoch:
            return None  # the optimiser does not know yet that all began anew
        if newest.datum is not None and newest.datum != self.datum:
            self._world = LocalFrame(newest.datum)
        state = newest.state
        if state is None:
            return None
        if self._path.predictor is None or newest.life != self._life:
            self._path.start(state, newest.gravity)
        elif state.stamp_ns < self._anchor_ns and self._is_rescued:
            return None  # of an optimiser that had been stopped: the samples since are no longer kept
        else:
            self._path.anchor(state, is_recovery=newest.recoveries != self._recoveries)
        self._life, self._recoveries, self._newest = newest.life, newest.recoveries, newest
        self._anchor_ns, self._is_rescued = state.stamp_ns, False
        self._buffer.forget_before(state.stamp_ns - KEPT_NS)
        return state

    def _rescue(self) -> None:
        """Without news for long: go on from the propagated state, and let a successor begin there."""
        assert self._newest is not None
        state = self._path.settle()
        self._newest = replace(self._newest, state=state)
        self._board.rescue.write(self._newest.pack())
        self._anchor_ns, self._is_rescued = state.stamp_ns, True
        self._buffer.forget_before(state.stamp_ns - KEPT_NS)

    def _told(self) -> Chronicle:
        """Return the chronicle with what has come until now."""
        if not self._is_closed:
            self._supervisor.collect()
        return self._chronicle

    def _hear_fault(self, why: str) -> None:
        """Note, in the thread of the supervisor, why an optimiser has ended."""
        words = self._board.words
        lost = words[Word.WAITING] + words[Word.BEGUN] - words[Word.REQUESTS]
        self._chronicle.hear_fault(self._buffer.latest_ns, why, lost)
        self._fault_version = self._slot.version
