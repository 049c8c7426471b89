"""The estimator on one page: a message comes in, it is checked, it becomes factors, an estimate goes out."""

from bisect import insort
from collections import Counter, deque
from collections.abc import Sequence
from typing import NamedTuple

import gtsam

from holdfast.config.model import Config
from holdfast.estimator.base import BaseKinematics
from holdfast.estimator.gnss_fusion import GnssFusion
from holdfast.estimator.health import HealthMonitor
from holdfast.estimator.initializer import Initializer
from holdfast.estimator.predictor import Predictor
from holdfast.estimator.standstill import StandstillUpdates
from holdfast.geometry.earth import Geodetic, LocalFrame, gravity
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.scans import Scan
from holdfast.graph.smoother import OptimiserError, Smoother
from holdfast.messages import GnssFix, Heading, ImuSample, JointAngle, LidarPose, Message
from holdfast.sensors.gnss import AntennaPosition, GnssModel
from holdfast.sensors.heading import AxisYaw, HeadingModel
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.lidar import LidarModel
from holdfast.state import BaseState, Estimate, Event, EventKind, Health, HealthReport, OptimisedState, Outcome

STANDARD_GRAVITY = 9.80665
RECENT = 64  # stamps per sensor among which a duplicate is looked for
FUTURE_NS = 1_000_000_000  # further ahead of the IMU's clock a stamp is an error


class Output(NamedTuple):
    """What one message led to: an estimate at an IMU sample, an optimisation, states that will not change any more.

    `base` is the state of the chassis at the estimate, if it is known.
    """

    estimate: Estimate | None = None
    optimised: OptimisedState | None = None
    smoothed: Sequence[tuple[int, gtsam.NavState]] = ()
    base: BaseState | None = None


class Pending(NamedTuple):
    """A checked measurement that waits until the IMU has reached its time."""

    stamp_ns: int
    order: int
    sensor: str
    content: AntennaPosition | AxisYaw | Scan


class Estimator:
    """Fuses the sensors of one machine; deterministic, and it does not die of bad data.

    Args:
        config: what the sensors are, where they sit, and how the estimator is to behave.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self.counts: Counter[tuple[str, Outcome]] = Counter()
        self.event_counts: Counter[EventKind] = Counter()
        self.events: list[Event] = []
        sensors = config.sensors
        self._buffer = ImuBuffer(sensors.imu)
        self._antennas = {
            name: GnssModel(gnss, config.T_I(gnss.frame)[:3, 3]) for name, gnss in sensors.antennas().items()
        }
        arms = [model.p_I_G for model in self._antennas.values()]
        baseline = arms[1] - arms[0] if len(arms) == 2 else None
        self._heading = None if sensors.heading is None else HeadingModel(sensors.heading, baseline)
        lidar = sensors.lidar
        self._lidar = None if lidar is None else LidarModel(lidar, gtsam.Pose3(config.T_I(lidar.frame)))
        self._gnss = GnssFusion(config, self._antennas, self._lidar, self._tell, self._count)
        self._base = BaseKinematics(config, self._tell, self._count) if config.has_base() else None
        self._health = HealthMonitor(config)
        self._hears_imu = True
        self._told = Health.INITIALISING
        self._world: LocalFrame | None = None
        self._initializer: Initializer | None = None
        self._started = False
        self._pending: list[Pending] = []
        self._order = 0
        self._recent: dict[str, deque[int]] = {}
        self._standstill = StandstillUpdates(config.standstill, self._buffer)
        datum = config.frames.datum
        if datum is not None:
            self._set_datum(Geodetic(datum.latitude_deg, datum.longitude_deg, datum.altitude_m))
        elif not self._antennas:
            self._begin(config.frames.gravity or STANDARD_GRAVITY)

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
        return self._started

    @property
    def waiting_for(self) -> str:
        """What keeps the estimator from starting."""
        return self._initializer.reason if self._initializer else "no usable GNSS fix has come"

    @property
    def health(self) -> Health:
        """How the estimator is now, in one word."""
        return self._health.assess(
            self._buffer.latest_ns,
            hears_imu=self._hears_imu,
            is_lost=self._started and self._graph.is_lost,
            antenna_lost=self._started and self._gnss.has_lost,
        )

    def health_report(self) -> HealthReport:
        """Return the health now with what it rests on."""
        return self._health.report(self._buffer.latest_ns, self.health)

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self.events = self.events, []
        return events

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival."""
        if isinstance(message, ImuSample):
            return self._process_base(message) if message.sensor == "base_imu" else self._process_imu(message)
        if isinstance(message, GnssFix):
            return self._process_fix(message)
        if isinstance(message, LidarPose):
            return self._process_lidar(message)
        if isinstance(message, Heading):
            return self._process_heading(message)
        return self._process_base(message)

    # --- IMU -----------------------------------------------------------------------------------------------------

    def _process_imu(self, sample: ImuSample) -> Output:
        outcome = self._buffer.check(sample)
        self.counts[sample.sensor, outcome] += 1
        if outcome is not Outcome.USED:
            return Output()
        was_heard_ns = self._buffer.latest_ns
        if sample.stamp_ns + self._buffer.offset_ns < was_heard_ns:
            self._start_over(sample)
        step = self._buffer.add(sample)
        stamp = self._buffer.latest_ns
        if not self._started:
            return Output()
        if self._buffer.gap_found_ns is not None:
            self._tell(EventKind.IMU_GAP, self._buffer.gap_found_ns, sample.sensor, "samples on a straight line")
            for smoother in self._graph.smoothers():
                smoother.mark_silent(self._buffer.gap_found_ns)
        elif stamp - was_heard_ns > self._buffer.max_gap_ns:
            silence = (stamp - was_heard_ns) * 1e-9
            self._tell(EventKind.IMU_GAP, was_heard_ns, sample.sensor, f"no samples for {silence:.3f} s")
        if stamp <= self._predictor.stamp_ns:
            return Output()  # a measurement in a silent stretch has led the state past this sample
        estimate = self._predictor.add(stamp, step)
        self._hears_imu = estimate.from_imu
        base = self._base.at(estimate) if self._base is not None else None
        ready = self._pending and self._pending[0].stamp_ns <= stamp
        overdue = stamp - self._graph.published.newest_ns > self._node_interval_ns
        return self._update(stamp, estimate, base) if ready or overdue else Output(estimate, base=base)

    def _process_base(self, message: ImuSample | JointAngle) -> Output:
        if self._base is not None:
            self._base.add(message, self._buffer.arrival_ns)
        else:
            self.counts[message.sensor, Outcome.IGNORED] += 1
        return Output()

    # --- measurements --------------------------------------------------------------------------------------------

    def _process_fix(self, fix: GnssFix) -> Output:
        model = self._antennas[fix.sensor]
        stamp = fix.stamp_ns + model.offset_ns
        outcome = model.check(fix)
        if outcome is Outcome.USED:
            outcome = self._check_stamp(stamp, fix)
        if outcome is not Outcome.USED:
            if self._started:
                self._gnss.refuse(fix.sensor, outcome)
            return self._reject(fix, outcome)
        point = Geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        if self._world is None:
            self._set_datum(point)
        assert self._world is not None
        position = AntennaPosition(stamp, fix.sensor, self._world.to_enu(point), model.covariance(fix))
        if self._started:
            return self._enqueue(stamp, fix, position)
        assert self._initializer is not None
        self.counts[fix.sensor, Outcome.BEFORE_START] += 1
        self._initializer.add_position(position)
        return self._try_to_start()

    def _process_lidar(self, pose: LidarPose) -> Output:
        assert self._lidar is not None
        stamp = pose.stamp_ns + self._lidar.offset_ns
        outcome = self._lidar.check(pose)
        if outcome is Outcome.USED:
            outcome = self._check_stamp(stamp, pose)
        if outcome is not Outcome.USED:
            return self._reject(pose, outcome)
        T_I0_I = self._lidar.T_I0_I(pose)
        if self._started:
            return self._enqueue(stamp, pose, Scan(stamp, T_I0_I))
        self.counts[pose.sensor, Outcome.BEFORE_START] += 1
        if self._initializer is not None:
            self._initializer.add_track(stamp, T_I0_I)
            if not self._antennas:
                return self._try_to_start()
        return Output()

    def _process_heading(self, heading: Heading) -> Output:
        assert self._heading is not None
        stamp = heading.stamp_ns + self._heading.offset_ns
        outcome = self._heading.check(heading)
        if outcome is Outcome.USED:
            outcome = self._check_stamp(stamp, heading)
        if outcome is not Outcome.USED:
            return self._reject(heading, outcome)
        measured = self._heading.measured(heading)
        if self._started:
            return self._enqueue(stamp, heading, measured)
        self.counts[heading.sensor, Outcome.BEFORE_START] += 1
        if self._initializer is not None:
            self._initializer.add_heading(measured)
        return Output()

    def _check_stamp(self, stamp_ns: int, message: GnssFix | LidarPose | Heading) -> Outcome:
        recent = self._recent.setdefault(message.sensor, deque(maxlen=RECENT))
        if stamp_ns in recent:
            return Outcome.DUPLICATE
        if self._is_future(stamp_ns, message.arrival_ns):
            return Outcome.CLOCK_JUMP
        recent.append(stamp_ns)
        return Outcome.USED

    def _is_future(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Whether a stamp is further ahead of the IMU's clock than silence of the IMU explains."""
        heard = self._buffer.latest_ns
        return heard > 0 and stamp_ns - heard > max(0, arrival_ns - self._buffer.arrival_ns) + FUTURE_NS

    def _reject(self, message: GnssFix | LidarPose | Heading, outcome: Outcome) -> Output:
        self.counts[message.sensor, outcome] += 1
        self._tell(EventKind.REJECTED, message.stamp_ns, message.sensor, outcome)
        return Output()

    def _enqueue(
        self, stamp_ns: int, message: GnssFix | LidarPose | Heading, content: AntennaPosition | AxisYaw | Scan
    ) -> Output:
        if stamp_ns < self._graph.published.oldest_ns:
            behind = (self._graph.published.newest_ns - stamp_ns) * 1e-9
            self.counts[message.sensor, Outcome.LATE] += 1
            self._tell(EventKind.LATE, stamp_ns, message.sensor, f"{behind:.3f} s behind the newest state")
            return Output()
        self._order += 1
        insort(self._pending, Pending(stamp_ns, self._order, message.sensor, content))
        if message.arrival_ns - self._buffer.arrival_ns <= self._buffer.max_gap_ns:
            return Output()  # the next sample of the IMU takes it in, with what else has come until then
        return self._update(max(self._buffer.latest_ns, stamp_ns))  # the IMU is silent: do not wait for it

    # --- starting ------------------------------------------------------------------------------------------------

    def _set_datum(self, datum: Geodetic) -> None:
        self._world = LocalFrame(datum)
        self._begin(self.config.frames.gravity or gravity(datum.latitude_deg, datum.altitude_m))

    def _begin(self, g: float) -> None:
        self._gravity = g
        self._initializer = Initializer(self.config, self._buffer, self._antennas, self._lidar, self._heading, g)
        self._node_interval_ns = round(self.config.graph.max_node_interval_s * 1e9)

    def _try_to_start(self) -> Output:
        assert self._initializer is not None
        before = self._initializer.reason
        state = self._initializer.attempt()
        if state is None:
            if self._initializer.reason != before:
                self._tell(EventKind.WAITING, self._buffer.latest_ns, "", self._initializer.reason)
            return Output()
        self._graph = DualGraph(self.config, self._buffer, self._gravity, self._lidar, state)
        self._gnss.restart()
        self._health.start(state.stamp_ns)
        self._predictor = Predictor(self.config, self._buffer, self._gravity, state)
        self._started = True
        self._tell(EventKind.INITIALISED, state.stamp_ns, "", self._initializer.reason)
        return Output(None, state)

    def _start_over(self, sample: ImuSample) -> None:
        """Begin anew after the IMU's clock has gone back for good: no stamp of before compares with one of now."""
        self._tell(EventKind.CLOCK_STEP, sample.stamp_ns, sample.sensor, "the clock has gone back: starting over")
        self._buffer.clear()
        self._pending.clear()
        self._recent.clear()
        self._started = False
        self._health.stop()
        self._standstill = StandstillUpdates(self.config.standstill, self._buffer)
        if self._initializer is not None:
            self._begin(self._gravity)

    # --- optimising ----------------------------------------------------------------------------------------------

    def _update(self, reached_ns: int, estimate: Estimate | None = None, base: BaseState | None = None) -> Output:
        """Add every measurement whose time the IMU has reached, optimise once, and re-propagate to the present."""
        while self._pending and self._pending[0].stamp_ns <= reached_ns:
            self._add(self._pending.pop(0))
        for smoother in self._graph.smoothers():
            if self._buffer.latest_ns - smoother.newest_ns > self._node_interval_ns:
                smoother.node(self._buffer.latest_ns // self._node_interval_ns * self._node_interval_ns)
        standing = self._standstill.add_to(self._graph.smoothers())
        if standing:
            self.counts["standstill", Outcome.USED] += standing
        for smoother in self._graph.smoothers():
            self._optimise(smoother)
        is_recovery = self._gnss.review(self._graph, self._buffer.latest_ns)
        if is_recovery:
            self._health.recovered(self._buffer.latest_ns)
        if (health := self.health) is not self._told:
            self._told = health
            self._tell(EventKind.HEALTH, self._buffer.latest_ns, "", health)
        published = self._graph.published
        self._predictor.anchor(published.state, is_recovery=is_recovery)
        self._buffer.forget_before(min(s.oldest_ns for s in self._graph.smoothers()) - self._node_interval_ns)
        return Output(estimate, published.state, published.settled(), base)

    def _optimise(self, smoother: Smoother) -> None:
        try:
            smoother.optimise()
        except OptimiserError as fault:
            self._tell(EventKind.OPTIMISER_FAULT, smoother.newest_ns, "", str(fault))
            self._graph.forget_scans(smoother)
            self._health.reset(self._buffer.latest_ns)
            if smoother is self._graph.main:
                self._gnss.forget_window()

    def _add(self, pending: Pending) -> None:
        content = pending.content
        if isinstance(content, AntennaPosition):
            outcome = self._gnss.add(self._graph, content, self._buffer.latest_ns)
        elif isinstance(content, AxisYaw):
            assert self._heading is not None
            outcome = self._gnss.add_heading(self._graph, self._heading, content)
        else:
            outcome = self._add_scan(content, pending.sensor)
        self.counts[pending.sensor, outcome] += 1
        if outcome is Outcome.USED:
            self._health.entered(pending.sensor, pending.stamp_ns)
        if outcome is Outcome.LATE:
            self._tell(EventKind.LATE, pending.stamp_ns, pending.sensor, "left the window while it waited")

    def _add_scan(self, scan: Scan, sensor: str) -> Outcome:
        outcome = self._graph.add_scan(scan)
        if self._graph.jumped_ns == scan.stamp_ns:
            self._tell(EventKind.LIDAR_JUMP, scan.stamp_ns, sensor, "the IMU did not feel this motion")
            self._gnss.forget_track()
        return outcome

    def _count(self, sensor: str, outcome: Outcome, number: int) -> None:
        self.counts[sensor, outcome] += number

    def _tell(self, kind: EventKind, stamp_ns: int, sensor: str, reason: str) -> None:
        self.event_counts[kind] += 1
        self.events.append(Event(stamp_ns, kind, sensor, reason))
