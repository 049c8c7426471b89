"""All that exists only after the start: the graphs, what guards them, and the measurements that wait for the IMU."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import gtsam

from holdfast.config.model import Config
from holdfast.estimator.clock import MAX_SILENCE_NS
from holdfast.estimator.epochs import Epochs
from holdfast.estimator.health import HealthMonitor
from holdfast.estimator.imu_path import Received
from holdfast.estimator.judgement import Judgement
from holdfast.estimator.learnt_view import LearntView
from holdfast.estimator.plausible_speed import PlausibleSpeed
from holdfast.estimator.queue import MeasurementQueue
from holdfast.estimator.standstill import STANDSTILL, StandstillUpdates
from holdfast.estimator.successor import Successor
from holdfast.estimator.wandering import Wandering
from holdfast.estimator.window_length import WindowLength
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.smoother import OptimiserError, Smoother
from holdfast.integrity.calibration import Calibration
from holdfast.integrity.headings import Headings
from holdfast.integrity.late_sensors import late_poses, late_receivers
from holdfast.integrity.learnt_constants import carried_priors, constants_of_machine, learnt_constants
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.integrity.lever_arms import LeverArms
from holdfast.integrity.noise_review import NoiseReview
from holdfast.integrity.noise_scale import NoiseScale
from holdfast.integrity.odometries import Odometries
from holdfast.integrity.positions import Positions
from holdfast.integrity.recovery import Recovery
from holdfast.integrity.states import JointAt, States
from holdfast.integrity.yaw_learning import Witness
from holdfast.messages import Message
from holdfast.sensors.clock import is_by_gnss_clock, measured_later, with_estimated_clock
from holdfast.sensors.constants import Constant, priors_of_machine
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.lever_arm import GNSS_ARM
from holdfast.sensors.noise import Colour
from holdfast.sensors.odometry import TrackPose
from holdfast.sensors.sensor import ConstraintSensor, Measurement, Role, Sensor, of_role
from holdfast.state import OptimisedState

Channel = Callable[[DualGraph, Any, int], Outcome]
"""Takes the graphs, a measurement and the time that the IMU has reached; says what became of the measurement."""

WITNESSES = Role.POSITION, Role.VELOCITY  # of motion, where the machine was believed to stand


class Update(NamedTuple):
    """What one optimisation led to.

    `smoothed` are nodes that will not change any more; `is_recovery` says that GNSS was regained by it, `begins_anew`
    that the state is none of the graphs, but that from which others are to begin. `standing` are times at which the
    machine was found to stand.
    """

    state: OptimisedState
    smoothed: Sequence[tuple[int, gtsam.NavState]]
    is_recovery: bool
    begins_anew: bool = False
    standing: Sequence[int] = ()


class Tracking:
    """The estimator from one start to the next.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        sensors: all models, by name.
        gravity: [m/s^2].
        state: the first one.
        scales: of the noise of the sensors, by name.
        lever_arms: what is believed of them.
        successor: what the estimator would begin anew from.
        window: how long the sliding window is to be.
        joint_at: tells the turn joint.
        monitor: of the health.
        log: where counts and events go.
        carried: what was learnt of the sensors before.
    """

    def __init__(
        self,
        config: Config,
        buffer: ImuBuffer,
        sensors: Mapping[str, Sensor],
        gravity: float,
        state: OptimisedState,
        *,
        scales: Mapping[str, NoiseScale],
        lever_arms: LeverArms,
        successor: Successor,
        window: WindowLength,
        joint_at: JointAt,
        monitor: HealthMonitor,
        log: EventLog,
        carried: LearntSnapshot = NOTHING_LEARNT,
    ) -> None:
        self._buffer, self._log, self._monitor = buffer, log, monitor
        self._roles = {name: sensor.role for name, sensor in sensors.items()}
        self._constraints = [sensor for sensor in sensors.values() if isinstance(sensor, ConstraintSensor)]
        self._clock_ns = successor.start.clock_ns  # by which stamps of GNSS are known to be early
        self._by_gnss_clock = {name for name, sensor in sensors.items() if is_by_gnss_clock(sensor)}
        sensors = {name: with_estimated_clock(sensor, self._clock_ns * 1e-9) for name, sensor in sensors.items()}
        receivers = of_role(sensors, Role.POSITION)
        self._positions = Positions(
            config.gate,
            receivers,
            scales,
            lever_arms,
            log,
            since_ns=state.stamp_ns,
            believe_after_s=config.gate.patience_s(has_odometry=bool(of_role(sensors, Role.ODOMETRY))),
            accelerometer=carried.accelerometer,
        )
        self._headings = Headings(of_role(sensors, Role.HEADING), scales, log, successor.start.clocks.move)
        self._odometries = Odometries(
            config,
            of_role(sensors, Role.ODOMETRY),
            log,
            headings=self._heading_witness,
            fixes=successor.start.fixes_vouch_for,
            date_later=successor.start.clocks.move,
            carried=carried.odometries,
        )
        successor.start.weigh_odometries(self._odometries.noises)
        self._states = States(of_role(sensors, Role.STATE, Role.VELOCITY, Role.POSE), scales, joint_at, log)
        self._recovery = Recovery(config.gate, self._positions, self._headings, self._odometries, log)
        self._channels: dict[Role, Channel] = {
            Role.POSITION: late_receivers(receivers, self._positions, log, successor.start.clocks.move).add,
            Role.HEADING: self._headings.add,
            Role.ODOMETRY: self._odometries.add,
            Role.STATE: self._states.add,
            Role.VELOCITY: self._states.add,
            Role.POSE: late_poses(of_role(sensors, Role.POSE), self._states, log, successor.start.clocks.move).add,
        }
        self.successor, self._scales, self._window = successor, scales, window
        self._wandering = Wandering(successor.start, self._states, self._positions)
        self._standstill = StandstillUpdates(config.standstill, buffer, gravity, successor.start.stands)
        self._plausible_speed = PlausibleSpeed(config.gate)
        self._node_interval_ns = round(config.graph.max_node_interval_s * 1e9)
        self._due_ns: int | None = None
        self._constrained_ns = state.stamp_ns
        self._late: set[str] = set()  # sensors whose last measurement was too late
        self._calibration = Calibration(sensors, config.imu_name, log)
        self._noise_review = NoiseReview(config.imu_name, log)
        self._priors = priors_of_machine(config, sensors)
        self._machine_constants = constants_of_machine(config, sensors, lever_arms.doubts())
        self._epochs, self.queue = Epochs(), MeasurementQueue(round(config.graph.lag_s * 1e9) // 6)
        known = carried_priors(carried.constants, self._machine_constants)
        self.graph = DualGraph(
            config,
            buffer,
            gravity,
            self._odometries.new_tracks(),
            state,
            carried=known,
            found={name: one for name, one in successor.start.found.priors.items() if name in self._priors},
            arm=self._priors.get(GNSS_ARM),
        )
        self.graph.main.imu_noise.walk_scale = successor.walk_scale
        self._judgement = Judgement(
            config.gate,
            self.graph,
            successor,
            log,
            positions=self._positions,
            states=self._states,
            odometries=self._odometries,
            priors=self._priors,
        )
        self._judgement.hold_mistaken(state.stamp_ns)

    @property
    def is_due(self) -> bool:
        """Whether an update should follow."""
        return self._due_ns is not None

    @property
    def is_lost(self) -> bool:
        """Whether no receiver of positions is trusted."""
        return self.graph.is_lost

    def lost(self) -> list[str]:
        """Return the sensors that are not trusted."""
        channels = self._positions, self._headings, self._odometries, self._states
        return [name for channel in channels for name in channel.lost()]

    @property
    def distrusted(self) -> frozenset[str]:
        """Odometries that lie, and receivers that are elsewhere: an estimate that begins anew trusts them neither."""
        return self._odometries.distrusted | self._positions.misplaced

    def constants(self) -> dict[str, Constant]:
        """Return what the graph knows of the constants of sensors, by sensor or by what several share."""
        return self.graph.main.constants(self._priors)

    def view(self) -> LearntView:
        """Return what is known of the sensors, to be read at any time until the next start."""
        return LearntView(
            lambda sensor: self._scales[sensor].ratio_of_weighed if sensor in self._scales else 1.0,
            self.graph.published.measured,
            self.constants,
            self._colour,
            lambda: self.graph.main.imu_noise.force_scale,
            lambda: self._buffer.sway,
        )

    def _colour(self, sensor: str, colour: Colour, above: float) -> Colour:
        return self._scales[sensor].white.colour(colour, above)

    def _heading_witness(self, smoother: Smoother, stamp_ns: int) -> Witness | None:
        return self._headings.witness(smoother, stamp_ns) or self._positions.heading_witness(smoother, stamp_ns)

    def learnt(self) -> LearntSnapshot:
        """Return what was learnt of the sensors since the start, and carried to it."""
        noise = {name: scale.learnt() for name, scale in self._scales.items()}
        constants = {name: one for name, one in self.constants().items() if name in self._machine_constants}
        return LearntSnapshot(
            odometries=self._odometries.learnt(),
            noise={name: one for name, one in noise.items() if one is not None},
            constants=learnt_constants(constants),
            accelerometer=self._positions.learnt_accelerometer(),
        )

    def distrust(self, names: Collection[str]) -> None:
        """Begin with receivers and odometries that are not trusted."""
        self._positions.distrust(names)
        self._odometries.distrust(names)

    def leave_out(self, names: Collection[str]) -> None:
        """Begin without odometries that lie, and receivers that are elsewhere than they say."""
        self._positions.leave_out(names)
        self._odometries.distrust(names)

    def go_on_from(self, before: "Tracking") -> None:
        """Begin with what was found wrong of sensors before the estimate began anew."""
        for waiting in before.queue.drain():
            self.queue.push(self._dated(waiting, before._early_ns(waiting)))
        self.leave_out(before.distrusted)
        self._odometries.go_on_from(self.graph, before._odometries)

    def _dated(self, measurement: Measurement, in_stamp_ns: int = 0) -> Measurement:
        """Return a measurement, its stamp corrected by what is known of the clock, of which so much is in it."""
        if isinstance(measurement, TrackPose):
            return self._odometries.dated(measurement)
        return measured_later(measurement, self._early_ns(measurement) - in_stamp_ns)

    def _early_ns(self, measurement: Measurement) -> int:
        """Return by how much the stamp of a measurement is known to be early; of a velocity no graph estimates that."""
        if measurement.sensor not in self._by_gnss_clock:
            return 0
        is_velocity = self._roles[measurement.sensor] is Role.VELOCITY
        return self.successor.start.clock_ns if is_velocity else self._clock_ns

    def refuse(self, message: Message, outcome: Outcome) -> None:
        """Note a message that cannot be used."""
        if self._roles[message.sensor] is Role.POSITION:
            self._positions.refuse(message.sensor, outcome)

    def receive(self, received: Received) -> bool:
        """Take note of a sample of the IMU; say whether the state can be carried to it."""
        stamp = self._buffer.latest_ns
        if received.line_since_ns is not None:
            self._report_gap(received.line_since_ns, "samples on a straight line")
            for smoother in self.graph.smoothers():
                smoother.mark_silent(received.line_since_ns)
        elif stamp - received.before_ns > self._buffer.max_gap_ns:
            gap_ns = stamp - received.before_ns
            self._report_gap(received.before_ns, f"no samples for {gap_ns * 1e-9:.3f} s")
            for channel in self._positions, self._headings, self._odometries, self._states:
                channel.pass_over(gap_ns)
        published = self.graph.published
        if stamp <= published.newest.stamp_ns:
            return False  # a measurement in a silent stretch has led the state past this sample
        is_ready = self.queue.is_due(stamp) and not self._epochs.is_incomplete(self._buffer.arrival_ns)
        if is_ready or stamp - published.newest_ns > self._node_interval_ns:
            self._due_ns = stamp
        return True

    def _report_gap(self, since_ns: int, reason: str) -> None:
        self._log.report(EventKind.IMU_GAP, since_ns, self._log.imu, reason)

    def enqueue(self, measurement: Measurement, arrival_ns: int, *, claimed: Measurement) -> None:
        """Let a measurement wait until the IMU has reached its time, unless it is too late.

        What would begin anew takes it as it was claimed: fixes that wander would else fit to each other.
        """
        measurement = self._dated(measurement)
        if measurement.sensor not in self.distrusted:
            self.successor.add(measurement if isinstance(measurement, TrackPose) else claimed)
        stamp_ns, name, published = measurement.stamp_ns, measurement.sensor, self.graph.published
        if stamp_ns < published.oldest_ns:
            self._log.count(name, Outcome.LATE)
            self._log.record(stamp_ns, name, Outcome.LATE)
            behind_ns = published.newest_ns - stamp_ns
            if name not in self._late:
                self._log.report(EventKind.LATE, stamp_ns, name, f"{behind_ns * 1e-9:.3f} s behind the newest state")
                self._late.add(name)
            if self._roles[name] is Role.POSITION and behind_ns > self._window.now_ns:  # not only begun since
                self._positions.refuse(name, Outcome.LATE)
            return
        self._late.discard(name)
        if stamp_ns - published.newest_ns > MAX_SILENCE_NS:
            self._log.record(stamp_ns, name, Outcome.CLOCK_JUMP)
            self._log.count(name, Outcome.CLOCK_JUMP)  # nothing leads there until the IMU begins anew
            return
        is_carried = self._odometries.carry and not isinstance(measurement, TrackPose)
        self.queue.push(measurement, self._buffer.latest_ns - stamp_ns if is_carried else 0)
        self._epochs.add(name, stamp_ns, arrival_ns)
        # as a rule a sample of the IMU takes it in, with what else has come until then
        if arrival_ns - self._buffer.arrival_ns > self._buffer.max_gap_ns:  # it is silent: do not wait for it
            self.queue.take_late()
            self._due_ns = max(self._due_ns or 0, self._buffer.latest_ns, stamp_ns)

    def update(self) -> Update:
        """Add every measurement whose time the IMU has reached, and optimise once."""
        now_ns = self._buffer.latest_ns
        reached_ns, self._due_ns = max(self._due_ns or 0, now_ns), None
        self._push_constraints(now_ns)
        for measurement in self.queue.pop_due(reached_ns):
            self._take(measurement)
        for smoother in self.graph.smoothers():
            if now_ns - smoother.newest_ns > self._node_interval_ns:
                smoother.node(now_ns // self._node_interval_ns * self._node_interval_ns)
        standing = self._standstill.add_to(self.graph.smoothers())
        if standing:
            self._log.count(STANDSTILL, Outcome.USED, len(standing))
        self._plausible_speed.add_to(self.graph.smoothers())
        was_vague = False
        for smoother in self.graph.smoothers():
            smoother.lengthen(self._window.now_ns)
            was_vague |= smoother.turn_vague(self.successor.start.compass.beside)
            self._optimise(smoother)
        for exchange in self._positions.newly_exchanged():
            self.successor.start.exchange(exchange)
        is_recovery = self._recovery.review(self.graph, now_ns)
        self._wandering.review(now_ns)
        for channel in self._headings, self._states:
            channel.review(self.graph, now_ns)
        self._judgement.hold_mistaken(now_ns)
        self._odometries.review(now_ns)
        self._calibration.review(self.graph.main, now_ns)
        self._judgement.tell_constants(now_ns)
        self._noise_review.review(self._odometries, self._positions.learnt_accelerometer(), now_ns)
        self.successor.calm(now_ns)
        if not self.graph.is_lost:
            self.successor.start.compass.travel.note(self.graph.published.newest)
        published = self.graph.published
        published.imu_noise.walk_scale = self.successor.walk_scale
        beginning = self._judgement.beginning(now_ns, was_vague=was_vague)
        if beginning is not None:
            return Update(beginning.state, (), is_recovery=True, begins_anew=True)
        if is_recovery:
            self._monitor.recovered(now_ns)
        return Update(published.newest, published.settled(), is_recovery, standing=standing)

    def drop_samples(self) -> None:
        """Drop the samples that no window needs any more."""
        oldest_ns = min(smoother.oldest_ns for smoother in self.graph.smoothers())
        self._buffer.forget_before(min(oldest_ns - self._node_interval_ns, self.successor.oldest_ns))

    def _push_constraints(self, now_ns: int) -> None:
        since_ns, self._constrained_ns = max(self._constrained_ns, self.graph.published.oldest_ns), now_ns
        for sensor in self._constraints:
            first = since_ns // sensor.period_ns + 1
            for stamp_ns in range(first * sensor.period_ns, now_ns + 1, sensor.period_ns):
                # in a drop-out the attitude is known too badly for what is linear about it
                if self._buffer.is_trusted(stamp_ns - sensor.period_ns, stamp_ns):
                    self.queue.push(sensor.at(stamp_ns))

    def _take(self, measurement: Measurement) -> None:
        name = measurement.sensor
        outcome = self._channels[self._roles[name]](self.graph, measurement, self._buffer.latest_ns)
        self._log.count(name, outcome)
        self._monitor.note_noise(name, self._scales[name].ratio)
        if outcome is Outcome.USED:
            self._monitor.entered(name, measurement.stamp_ns)
        elif outcome is Outcome.INNOVATION and self._roles[name] in WITNESSES:
            taken = self._standstill.take_back(self.graph.smoothers())
            self._log.count(STANDSTILL, Outcome.USED, -taken)
            self._log.count(STANDSTILL, Outcome.CONTRADICTED, taken)
        if outcome is Outcome.LATE:
            self._log.report(EventKind.LATE, measurement.stamp_ns, name, "left the window while it waited")

    def _optimise(self, smoother: Smoother) -> None:
        try:
            smoother.optimise()
        except OptimiserError as fault:
            self._log.report(EventKind.OPTIMISER_FAULT, smoother.newest_ns, "", str(fault))
            self.graph.begin_tracks_anew(within=smoother)
            self._monitor.reset(self._buffer.latest_ns)
            if smoother is self.graph.main:
                self._recovery.forget_window()
