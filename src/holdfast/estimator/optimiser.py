"""The half of the estimator that optimises: it converts messages, and hands them to what comes before or after a start.

Its phase is an `Initialising` or a `Tracking`; a restart makes a new one. Of the old one survives what was learnt of
the sensors, unless someone asked for the restart.
"""

from collections import Counter
from collections.abc import Collection
from typing import TYPE_CHECKING

from holdfast.chassis.encoder import JointModel
from holdfast.chassis.joint_track import JointTrack
from holdfast.config.model import Config
from holdfast.estimator.assumptions import Assumptions
from holdfast.estimator.density import Density
from holdfast.estimator.far_clocks import FarClocks
from holdfast.estimator.health import HealthMonitor
from holdfast.estimator.imu_path import Received
from holdfast.estimator.initialisation import Initialising
from holdfast.estimator.stamp_check import StampCheck
from holdfast.estimator.successor import Successor
from holdfast.estimator.tracking import Tracking, Update
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Health, Outcome
from holdfast.geometry.earth import Geodetic
from holdfast.geometry.world import MOVED, World
from holdfast.graph.solver import GTSAM_ERRORS
from holdfast.integrity.exchanges import Exchanges
from holdfast.integrity.learnt_constants import found_before
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.integrity.lever_arms import LeverArms
from holdfast.integrity.noise_scale import NoiseScale
from holdfast.integrity.scatter import Scatters
from holdfast.messages import JointAngle, Message
from holdfast.printable import first_line
from holdfast.sensors.constants import Constant
from holdfast.sensors.gnss import claimed_position
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.registry import inputs_of, sensors_of
from holdfast.sensors.sensor import Joint, Measurement, Position, Role, Sensor, of_role
from holdfast.state import OptimisedState

if TYPE_CHECKING:
    from holdfast.estimator.listener import Listener

LOST = EventKind.RECEIVER_LOST, EventKind.SENSOR_LOST
REGAINED = EventKind.RECEIVER_REGAINED, EventKind.SENSOR_REGAINED
LATE_NS = 10_000_000_000  # by which a measurement that starts the estimator may be late


class Optimiser:
    """Fuses measurements with the samples of a buffer that someone else fills.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        log: where counts and events go.
        listener: who is told of all that comes in and goes out.
        density: of the measurements that are taken in; None where who calls has thinned them out by their arrival.
        learnt: what was learnt of the sensors before.
    """

    def __init__(
        self,
        config: Config,
        buffer: ImuBuffer,
        log: EventLog,
        listener: "Listener | None" = None,
        density: Density | None = None,
        *,
        learnt: LearntSnapshot = NOTHING_LEARNT,
    ) -> None:
        self._config, self._buffer, self._log, self._density = config, buffer, log, density
        self._listener = listener
        self._start_span_ns = round(config.initialisation.window_s * 1e9) + LATE_NS
        self._sensors = sensors_of(config)
        self._know(learnt)
        self._inputs = frozenset(inputs_of(config))
        self._joint = None if config.joint is None else JointTrack(JointModel(config.joint[1]))
        self._has_imu, self._reported = True, Health.INITIALISING
        self._assumptions = Assumptions(self._sensors, log)
        self._scatters = Scatters(self._sensors, buffer, log, config.imu_name)
        self.monitor = HealthMonitor(config)
        self.world = World()
        self.gravity = config.frames.gravity or self.world.gravity
        self._lever_arms = LeverArms(self._sensors)
        self._phase: Initialising | Tracking = self._initialising()
        self._begin()
        if config.frames.datum is not None:
            self.place(config.frames.datum.point)

    def _begin(self) -> None:
        """Begin anew, before a start, with what was learnt until now."""
        self._learnt = self.learnt()
        self.close()
        self.monitor.stop()
        if self._listener is not None:
            self._listener.stop()
        self._stamps = StampCheck(self._buffer, self._log, self._config.graph, self.clocks)
        self._lever_arms = LeverArms(self._sensors)
        self._phase = self._initialising()

    def close(self) -> None:
        """Count what still waits for the IMU, which nothing will come for any more."""
        for measurement in self._phase.queue.drain() if isinstance(self._phase, Tracking) else ():
            position = measurement.p_W_P if isinstance(measurement, Position) else None
            self._log.count(measurement.sensor, Outcome.UNREACHED)
            self._log.record(measurement.stamp_ns, measurement.sensor, Outcome.UNREACHED, p_W_P=position)

    def _initialising(self, config: Config | None = None) -> Initialising:
        sensors = self._believed()
        found = found_before(self._learnt.constants, sensors)
        return Initialising(config or self._config, self._buffer, sensors, self.gravity, found, clocks=self.clocks)

    def _believed(self) -> dict[str, Sensor]:
        """Return the models as they are believed to be."""
        return self._exchanges.believed(self._lever_arms.believed(self._sensors))

    def _know(self, learnt: LearntSnapshot) -> None:
        """Know this of the sensors, and nothing else."""
        self._learnt, self._exchanges = learnt, Exchanges(learnt.names)
        self.clocks = FarClocks(self._log, learnt.early_ns)
        self._scales = {name: NoiseScale(learnt.noise.get(name)) for name in self._sensors}

    def learnt(self) -> LearntSnapshot:
        """Return what was learnt of the sensors until now, in this start or before it."""
        learnt = self._learnt.updated(self._phase.learnt()) if isinstance(self._phase, Tracking) else self._learnt
        return learnt.with_names(self._exchanges.learnt(), self.clocks.learnt())

    @property
    def _start_of_now(self) -> Initialising:
        """What collects for the start, or for one to begin anew with."""
        return self._phase.successor.start if isinstance(self._phase, Tracking) else self._phase

    @property
    def tracking(self) -> Tracking | None:
        """What exists only after the start."""
        return self._phase if isinstance(self._phase, Tracking) else None

    @property
    def is_due(self) -> bool:
        """Whether an update should follow."""
        return isinstance(self._phase, Tracking) and self._phase.is_due

    @property
    def waiting_for(self) -> str:
        """What keeps the estimator from starting."""
        if not isinstance(self._phase, Initialising):
            return ""
        return self._stamps.faults.why_not(of_role(self._sensors, Role.POSITION)) or self._phase.waiting_for

    @property
    def waiting(self) -> Counter[str]:
        """How many measurements of each sensor wait for the IMU."""
        return self._phase.queue.counts() if isinstance(self._phase, Tracking) else Counter()

    @property
    def is_lost(self) -> bool:
        """Whether no receiver of positions is trusted."""
        return isinstance(self._phase, Tracking) and self._phase.is_lost

    def constants(self) -> dict[str, Constant]:
        """Return what the graph knows of the constants of sensors; nothing before the start."""
        return self._phase.constants() if isinstance(self._phase, Tracking) else {}

    def lost(self) -> list[str]:
        """Return the sensors that are not trusted."""
        return self._phase.lost() if isinstance(self._phase, Tracking) else []

    @property
    def health(self) -> Health:
        """How the estimator is now, in one word."""
        return self.monitor.assess(
            self._buffer.latest_ns, has_imu=self._has_imu, is_lost=self.is_lost, lost=self.lost()
        )

    # --- what comes in -----------------------------------------------------------------------------------------------

    def receive(self, received: Received) -> None:
        """Take note of a sample of the IMU that has just entered the buffer."""
        stamp_ns = self._buffer.latest_ns
        if received.begins_anew:
            ahead_s = (stamp_ns - received.before_ns) * 1e-9
            seen = "the clock has gone back" if ahead_s < 0.0 else f"the clock went ahead by {ahead_s:.3f} s or stood"
            reason = f"{seen}: starting over"
            self._log.report(EventKind.CLOCK_STEP, stamp_ns - self._buffer.offset_ns, self._config.imu_name, reason)
            self._begin()
        if not isinstance(self._phase, Tracking):
            self._buffer.forget_before(stamp_ns - self._start_span_ns)
        elif self._phase.receive(received):
            self._has_imu = received.has_step
        if self._listener is not None:
            self._listener.receive(received)

    def wants(self, message: Message) -> bool:
        """Whether a message is of use here: a measurement, or the joint's angle for a sensor on the chassis."""
        return message.sensor in self._inputs

    def add(self, message: Message) -> OptimisedState | None:
        """Take in a message, in the order of arrival; return the first state if it was what the start needed."""
        if isinstance(message, JointAngle):
            if self._joint is not None:
                self._joint.add(message)
            return None
        frame, name = self.world.frame, message.sensor
        message = self._stamps.read(message, self._sensors[name].offset_ns)
        measurement = self._exchanges.named(self._sensors[name].convert(message, self.world))
        if self.world.frame is not frame:
            self._begin_in_world()
            if frame is not None:
                self._log.report(EventKind.RESET, message.stamp_ns, name, MOVED)
        outcome = measurement if isinstance(measurement, Outcome) else self._stamps.check(message, measurement.stamp_ns)
        if isinstance(measurement, Outcome) or outcome is not Outcome.USED:
            self._phase.refuse(message, outcome)
            self._record(message, measurement, outcome)
            if not self._stamps.is_told(name, outcome):
                self._log.report(EventKind.REJECTED, message.stamp_ns, name, outcome)
            return None
        if isinstance(measurement, Position) and self._lever_arms.repeats(measurement):
            self._record(message, measurement, Outcome.DUPLICATE)
            return None
        if self._density is not None and not self._density.admits(name, measurement.stamp_ns, message.arrival_ns):
            self._record(message, measurement, Outcome.OVERLOAD)
            return None
        self._assumptions.tell(message)
        if self.clocks.newly_moved():
            self._scatters.forget()
            self._start_of_now.forget_ahead()
        weighed = self._scatters.weighed(measurement, self._scales, self._stamps.even)
        if self._scatters.newly_swaying():
            self._start_of_now.found.forget()
        if self._listener is not None:
            self._listener.add(weighed, self._joint_at(measurement.stamp_ns))
        if isinstance(self._phase, Tracking):
            self._phase.enqueue(weighed, message.arrival_ns, claimed=measurement)
            return None
        self._record(message, measurement, Outcome.BEFORE_START)
        return self._try_to_start(self._phase, weighed)

    def _record(self, message: Message, measurement: Measurement | Outcome, outcome: Outcome) -> None:
        """Record what did not come as far as a test, with the position that it claims."""
        if outcome is not Outcome.OVERLOAD:  # of which the density has counted its own
            self._log.count(message.sensor, outcome)
        position = claimed_position(message, measurement, self.world.frame)
        stamp_ns = message.stamp_ns + self._sensors[message.sensor].offset_ns
        self._log.record(stamp_ns, message.sensor, outcome, p_W_P=position)

    # --- starting ----------------------------------------------------------------------------------------------------

    def restart(self, datum: Geodetic | None = None) -> None:
        """Begin anew because someone asks for it; a datum moves W there, else what was learnt is forgotten, too."""
        what = "reset" if datum is None else f"datum {datum.latitude_deg:.8f} {datum.longitude_deg:.8f}"
        self._log.report(EventKind.RESET, self._buffer.latest_ns, "", f"{what}: starting over")
        if datum is None:
            self.close()
            self._know(NOTHING_LEARNT)
            self._phase = self._initialising()
            self._begin()
        else:
            self.place(datum)

    def place(self, datum: Geodetic) -> None:
        """Put the origin of W somewhere, and begin anew."""
        self.world.place(datum)
        self._begin_in_world()

    def _begin_in_world(self) -> None:
        """Take gravity at the datum, which has just become known: what was collected in another W is begun anew."""
        self.gravity = self._config.frames.gravity or self.world.gravity
        self._scatters.forget()
        self._begin()

    def _try_to_start(self, phase: Initialising, measurement: Measurement) -> OptimisedState | None:
        if self._lever_arms.review(self._buffer.latest_ns, self._log):
            phase = self._phase = self._initialising()
        if not phase.add(measurement):
            return None
        before, state = phase.reason, phase.attempt()
        self._note_exchanges()
        if state is not None and not state.is_finite():
            reason = "the first state is not finite: starting over"
            self._log.report(EventKind.OPTIMISER_FAULT, self._buffer.latest_ns, "", reason)
            self._begin()
            return None
        if state is not None:
            tracking = self._start(state, Successor(phase))
            self._log.report(EventKind.INITIALISED, state.stamp_ns, "", phase.reason)
            self._leave_out(tracking, phase.doubtful)
        elif phase.reason != before:
            self._log.report(EventKind.WAITING, self._buffer.latest_ns, "", phase.reason)
        return state

    def resume(self, state: OptimisedState, lost: Collection[str]) -> None:
        """Go on where another optimiser has ended, at its last state, with receivers that it did not trust.

        What was in its window and came after the state is lost; the covariance of the state tells the rest.
        """
        self._start(state, Successor(self._initialising())).distrust(lost)
        self.monitor.reset(self._buffer.latest_ns)

    def _start(self, state: OptimisedState, successor: Successor) -> Tracking:
        self.world.settle()
        sensors = self._believed()
        if self._listener is not None:
            self._listener.start(state, sensors, self.gravity, successor.start.found.priors)
        tracking = Tracking(
            self._config,
            self._buffer,
            sensors,
            self.gravity,
            state,
            scales=self._scales,
            lever_arms=self._lever_arms,
            successor=successor,
            window=self._stamps.window,
            joint_at=self._joint_at,
            monitor=self.monitor,
            log=self._log,
            carried=self._learnt,
        )
        self.monitor.start(state.stamp_ns, doubts_arms=bool(self._lever_arms.doubts()))
        self._phase = tracking
        return tracking

    def _joint_at(self, stamp_ns: int) -> Joint | None:
        return None if self._joint is None else self._joint.at(stamp_ns)

    # --- optimising --------------------------------------------------------------------------------------------------

    def update(self) -> Update:
        """Add every measurement whose time the IMU has reached, and optimise once; it must have started."""
        assert isinstance(self._phase, Tracking)
        try:
            update = self._phase.update()
        except GTSAM_ERRORS as error:  # the smoother catches what it expects
            update = self._go_on_after(error, self._phase)
        self._note_exchanges()
        if self._listener is not None:
            self._listener.update(update, self._phase.view())
        if self._lever_arms.review(self._buffer.latest_ns, self._log):
            state = self._lever_arms.doubtful(update.state, self._config.imu.accelerometer_bias_sigma)
            update = Update(state, (), is_recovery=True, begins_anew=True)
            self._begin_anew(self._phase, update.state, self._without_heading())
        elif update.begins_anew:
            self._begin_anew(self._phase, update.state, self._phase.successor)
        if (health := self.health) is not self._reported:
            self._reported = health
            self._log.report(EventKind.HEALTH, self._buffer.latest_ns, "", health)
        return update

    def _go_on_after(self, error: Exception, before: Tracking) -> Update:
        """Go on at the last state where an update has failed, as a new process would."""
        reason = f"{type(error).__name__}: {first_line(error)}: going on from the last state"
        self._log.report(EventKind.OPTIMISER_FAULT, self._buffer.latest_ns, "", reason)
        self.resume(before.graph.published.newest, before.lost())
        return Update(before.graph.published.newest, (), is_recovery=True)

    def _note_exchanges(self) -> None:
        """Take positions from now on by the names of the antennas that they are of."""
        for exchange in self._start_of_now.newly_exchanged():
            self._exchanges.add(exchange, self._buffer.latest_ns, self._log)
            self._lever_arms.forget_means(exchange.pair)

    def _without_heading(self) -> Successor:
        """Return what would begin anew from the motion, by the lever arms as they are believed now."""
        start = self._config.initialisation.model_copy(update={"heading_deg": None})
        config = self._config.model_copy(update={"initialisation": start})
        return Successor(self._initialising(config), is_in_doubt=bool(self._lever_arms.doubts()))

    def _begin_anew(self, before: Tracking, state: OptimisedState, successor: Successor) -> None:
        """Let other graphs begin at a state, in which every sensor is trusted again."""
        now_ns, reason = self._buffer.latest_ns, "the estimate begins anew"
        self._learnt = self.learnt().without_constants()
        if before.is_lost:
            self._log.report(EventKind.GNSS_REGAINED, now_ns, "", reason)
        distrusted, doubtful = before.distrusted, successor.start.doubtful
        mistaken = {*successor.start.mistaken(), *distrusted, *doubtful}
        for name in before.lost():
            if name not in mistaken:
                self._report(REGAINED, name, reason)
        tracking = self._start(state, successor)
        tracking.go_on_from(before)
        self._leave_out(tracking, doubtful - distrusted)
        self.monitor.recovered(now_ns)

    def _leave_out(self, tracking: Tracking, names: Collection[str]) -> None:
        """Begin without odometries and receivers that the start has left out."""
        tracking.leave_out(names)
        for name in sorted(names):
            self._report(LOST, name, "at odds with the positions")

    def _report(self, kinds: tuple[EventKind, EventKind], name: str, reason: str) -> None:
        """Report what becomes of the trust in a sensor: of a receiver of positions the first kind, else the other."""
        kind = kinds[self._sensors[name].role is not Role.POSITION]
        self._log.report(kind, self._buffer.latest_ns, name, reason)

    def drop_samples(self) -> None:
        """Drop the samples that no window needs any more."""
        if isinstance(self._phase, Tracking):
            self._phase.drop_samples()
