"""The half of the estimator that optimises: it checks measurements, lets them wait for the IMU, and owns the graphs."""

from bisect import insort
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import gtsam

from holdfast.config.model import Config
from holdfast.estimator.gnss_fusion import GnssFusion
from holdfast.estimator.health import HealthMonitor
from holdfast.estimator.imu_path import Heard
from holdfast.estimator.initializer import Initializer
from holdfast.estimator.journal import Journal
from holdfast.estimator.standstill import StandstillUpdates
from holdfast.geometry.earth import STANDARD_GRAVITY_M_S2, Geodetic, LocalFrame, gravity
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.scans import Scan
from holdfast.graph.smoother import OptimiserError, Smoother
from holdfast.messages import GnssFix, Heading, LidarPose
from holdfast.sensors.gnss import AntennaPosition
from holdfast.sensors.heading import AxisYaw
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.suite import suite_of
from holdfast.state import EventKind, Health, OptimisedState, Outcome

RECENT = 64  # stamps per sensor among which a duplicate is looked for
LATE_NS = 10_000_000_000  # by which a measurement that starts the estimator may be late
FUTURE_NS = 1_000_000_000  # further ahead of the IMU's clock a stamp is an error

Measurement = GnssFix | LidarPose | Heading


class Pending(NamedTuple):
    """A checked measurement that waits until the IMU has reached its time."""

    stamp_ns: int
    order: int
    sensor: str
    content: AntennaPosition | AxisYaw | Scan


class Update(NamedTuple):
    """What one optimisation led to.

    `smoothed` are nodes that will not change any more; `is_recovery` says that GNSS was regained by it.
    """

    state: OptimisedState
    smoothed: Sequence[tuple[int, gtsam.NavState]]
    is_recovery: bool


class Optimiser:
    """Fuses measurements with the samples of a buffer that someone else fills.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        journal: where counts and events go.
    """

    def __init__(self, config: Config, buffer: ImuBuffer, journal: Journal) -> None:
        self._config = config
        self._buffer = buffer
        self._journal = journal
        self._tell = journal.tell
        self._antennas, self._heading, self._lidar = suite_of(config)
        self._gnss = GnssFusion(config, self._antennas, self._heading, self._lidar, journal)
        self._node_interval_ns = round(config.graph.max_node_interval_s * 1e9)
        self._start_window_ns = round(config.initialisation.window_s * 1e9) + LATE_NS
        self.graph: DualGraph
        self.gravity = STANDARD_GRAVITY_M_S2
        self.world: LocalFrame | None = None
        self.monitor = HealthMonitor(config)
        self._hears_imu = True
        self._told = Health.INITIALISING
        self._initializer: Initializer | None = None
        self.has_started = False
        self.pending: list[Pending] = []
        self._order = 0
        self._recent: dict[str, deque[int]] = {}
        self._standstill = StandstillUpdates(config.standstill, buffer)
        self._due_ns: int | None = None
        datum = config.frames.datum
        if datum is not None:
            self.place(Geodetic(datum.latitude_deg, datum.longitude_deg, datum.altitude_m))
        elif not self._antennas:
            self._begin(config.frames.gravity or STANDARD_GRAVITY_M_S2)

    @property
    def is_due(self) -> bool:
        """Whether an update should follow."""
        return self._due_ns is not None

    @property
    def waiting_for(self) -> str:
        """What keeps the estimator from starting."""
        return self._initializer.reason if self._initializer else "no usable GNSS fix has come"

    @property
    def is_lost(self) -> bool:
        """Whether no antenna is trusted."""
        return self.has_started and self.graph.is_lost

    @property
    def has_lost(self) -> bool:
        """Whether at least one antenna is not trusted."""
        return self.has_started and self._gnss.has_lost

    @property
    def health(self) -> Health:
        """How the estimator is now, in one word."""
        return self.monitor.assess(
            self._buffer.latest_ns, hears_imu=self._hears_imu, is_lost=self.is_lost, antenna_lost=self.has_lost
        )

    # --- IMU -----------------------------------------------------------------------------------------------------

    def hear(self, heard: Heard) -> None:
        """Take note of a sample that has just entered the buffer."""
        stamp, before_ns = self._buffer.latest_ns, heard.before_ns
        if heard.has_stepped_back:
            raw_ns = stamp - self._buffer.offset_ns
            self._tell(EventKind.CLOCK_STEP, raw_ns, "imu", "the clock has gone back: starting over")
            self._start_over()
        if not self.has_started:
            self._buffer.forget_before(stamp - self._start_window_ns)
            return
        if self._buffer.gap_found_ns is not None:
            self._tell(EventKind.IMU_GAP, self._buffer.gap_found_ns, "imu", "samples on a straight line")
            for smoother in self.graph.smoothers():
                smoother.mark_silent(self._buffer.gap_found_ns)
        elif stamp - before_ns > self._buffer.max_gap_ns:
            silence = (stamp - before_ns) * 1e-9
            self._tell(EventKind.IMU_GAP, before_ns, "imu", f"no samples for {silence:.3f} s")
        published = self.graph.published
        if stamp <= published.state.stamp_ns:
            return  # a measurement in a silent stretch has led the state past this sample
        self._hears_imu = heard.step is not None
        is_ready = bool(self.pending) and self.pending[0].stamp_ns <= stamp
        if is_ready or stamp - published.newest_ns > self._node_interval_ns:
            self._due_ns = stamp

    # --- measurements --------------------------------------------------------------------------------------------

    def add(self, message: Measurement) -> OptimisedState | None:
        """Take in a measurement, in the order of arrival; return the first state if it was what the start needed."""
        if isinstance(message, GnssFix):
            return self._add_fix(message)
        if isinstance(message, LidarPose):
            return self._add_lidar(message)
        return self._add_heading(message)

    def _add_fix(self, fix: GnssFix) -> OptimisedState | None:
        model = self._antennas[fix.sensor]
        stamp = fix.stamp_ns + model.offset_ns
        outcome = model.check(fix)
        if outcome is Outcome.USED:
            outcome = self._check_stamp(stamp, fix)
        if outcome is not Outcome.USED:
            if self.has_started:
                self._gnss.refuse(fix.sensor, outcome)
            self._reject(fix, outcome)
            return None
        point = Geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        if self.world is None:
            self.place(point)
        assert self.world is not None
        position = AntennaPosition(stamp, fix.sensor, self.world.to_enu(point), model.covariance(fix))
        if self.has_started:
            self._enqueue(stamp, fix, position)
            return None
        assert self._initializer is not None
        self._journal.count(fix.sensor, Outcome.BEFORE_START, 1)
        self._initializer.add_position(position)
        return self._try_to_start()

    def _add_lidar(self, pose: LidarPose) -> OptimisedState | None:
        assert self._lidar is not None
        stamp = pose.stamp_ns + self._lidar.offset_ns
        outcome = self._lidar.check(pose)
        if outcome is Outcome.USED:
            outcome = self._check_stamp(stamp, pose)
        if outcome is not Outcome.USED:
            self._reject(pose, outcome)
            return None
        T_I0_I = self._lidar.T_I0_I(pose)
        if self.has_started:
            self._enqueue(stamp, pose, Scan(stamp, T_I0_I))
            return None
        self._journal.count(pose.sensor, Outcome.BEFORE_START, 1)
        if self._initializer is not None:
            self._initializer.add_track(stamp, T_I0_I)
            if not self._antennas:
                return self._try_to_start()
        return None

    def _add_heading(self, heading: Heading) -> OptimisedState | None:
        assert self._heading is not None
        stamp = heading.stamp_ns + self._heading.offset_ns
        outcome = self._heading.check(heading)
        if outcome is Outcome.USED:
            outcome = self._check_stamp(stamp, heading)
        if outcome is not Outcome.USED:
            self._reject(heading, outcome)
            return None
        measured = self._heading.measured(heading)
        if self.has_started:
            self._enqueue(stamp, heading, measured)
            return None
        self._journal.count(heading.sensor, Outcome.BEFORE_START, 1)
        if self._initializer is not None:
            self._initializer.add_heading(measured)
        return None

    def _check_stamp(self, stamp_ns: int, message: Measurement) -> Outcome:
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

    def _reject(self, message: Measurement, outcome: Outcome) -> None:
        self._journal.count(message.sensor, outcome, 1)
        self._tell(EventKind.REJECTED, message.stamp_ns, message.sensor, outcome)

    def _enqueue(self, stamp_ns: int, message: Measurement, content: AntennaPosition | AxisYaw | Scan) -> None:
        if stamp_ns < self.graph.published.oldest_ns:
            behind = (self.graph.published.newest_ns - stamp_ns) * 1e-9
            self._journal.count(message.sensor, Outcome.LATE, 1)
            self._tell(EventKind.LATE, stamp_ns, message.sensor, f"{behind:.3f} s behind the newest state")
            return
        self._order += 1
        insort(self.pending, Pending(stamp_ns, self._order, message.sensor, content))
        # as a rule the next sample of the IMU takes it in, with what else has come until then
        if message.arrival_ns - self._buffer.arrival_ns > self._buffer.max_gap_ns:  # it is silent: do not wait for it
            self._due_ns = max(self._due_ns or 0, self._buffer.latest_ns, stamp_ns)

    # --- starting ------------------------------------------------------------------------------------------------

    def restart(self, datum: Geodetic | None = None) -> None:
        """Begin anew because someone asks for it; a datum moves W there."""
        what = "reset" if datum is None else f"datum {datum.latitude_deg:.8f} {datum.longitude_deg:.8f}"
        self._tell(EventKind.RESET, self._buffer.latest_ns, "", f"{what}: starting over")
        if datum is not None:
            self.world = None
        self._start_over()
        if datum is not None:
            self.place(datum)

    def place(self, datum: Geodetic) -> None:
        """Put the origin of W somewhere, before the start."""
        self.world = LocalFrame(datum)
        self._begin(self._config.frames.gravity or gravity(datum.latitude_deg, datum.altitude_m))

    def _begin(self, g: float) -> None:
        self.gravity = g
        self._initializer = Initializer(self._config, self._buffer, self._antennas, self._lidar, self._heading, g)

    def _try_to_start(self) -> OptimisedState | None:
        assert self._initializer is not None
        before = self._initializer.reason
        state = self._initializer.attempt()
        if state is None:
            if self._initializer.reason != before:
                self._tell(EventKind.WAITING, self._buffer.latest_ns, "", self._initializer.reason)
            return None
        self._start(state)
        self._tell(EventKind.INITIALISED, state.stamp_ns, "", self._initializer.reason)
        return state

    def resume(self, state: OptimisedState, lost: Iterable[str]) -> None:
        """Go on where another optimiser has ended, at its last state, with antennas that it did not trust.

        What was in its window and came after the state is lost; the covariance of the state tells the rest.
        """
        self._start(state)
        self._gnss.distrust(lost)
        self.monitor.reset(self._buffer.latest_ns)

    def lost_antennas(self) -> list[str]:
        """Return the antennas that are not trusted."""
        return self._gnss.lost() if self.has_started else []

    def _start(self, state: OptimisedState) -> None:
        self.graph = DualGraph(self._config, self._buffer, self.gravity, self._lidar, state)
        self._gnss.restart()
        self.monitor.start(state.stamp_ns)
        self.has_started = True

    def _start_over(self) -> None:
        """Forget what is known: no stamp of before compares with one of now, or someone asked for it."""
        self.pending.clear()
        self._recent.clear()
        self._due_ns = None
        self.has_started = False
        self.monitor.stop()
        self._standstill = StandstillUpdates(self._config.standstill, self._buffer)
        if self._initializer is not None:
            self._begin(self.gravity)

    # --- optimising ----------------------------------------------------------------------------------------------

    def update(self) -> Update:
        """Add every measurement whose time the IMU has reached, and optimise once."""
        reached_ns, self._due_ns = max(self._due_ns or 0, self._buffer.latest_ns), None
        while self.pending and self.pending[0].stamp_ns <= reached_ns:
            self._take(self.pending.pop(0))
        for smoother in self.graph.smoothers():
            if self._buffer.latest_ns - smoother.newest_ns > self._node_interval_ns:
                smoother.node(self._buffer.latest_ns // self._node_interval_ns * self._node_interval_ns)
        standing = self._standstill.add_to(self.graph.smoothers())
        if standing:
            self._journal.count("standstill", Outcome.USED, standing)
        for smoother in self.graph.smoothers():
            self._optimise(smoother)
        is_recovery = self._gnss.review(self.graph, self._buffer.latest_ns)
        if is_recovery:
            self.monitor.recovered(self._buffer.latest_ns)
        if (health := self.health) is not self._told:
            self._told = health
            self._tell(EventKind.HEALTH, self._buffer.latest_ns, "", health)
        published = self.graph.published
        return Update(published.state, published.settled(), is_recovery)

    def forget(self) -> None:
        """Drop the samples that no window needs any more."""
        self._buffer.forget_before(min(s.oldest_ns for s in self.graph.smoothers()) - self._node_interval_ns)

    def _optimise(self, smoother: Smoother) -> None:
        try:
            smoother.optimise()
        except OptimiserError as fault:
            self._tell(EventKind.OPTIMISER_FAULT, smoother.newest_ns, "", str(fault))
            self.graph.forget_scans(smoother)
            self.monitor.reset(self._buffer.latest_ns)
            if smoother is self.graph.main:
                self._gnss.forget_window()

    def _take(self, pending: Pending) -> None:
        content = pending.content
        if isinstance(content, AntennaPosition):
            outcome = self._gnss.add(self.graph, content, self._buffer.latest_ns)
        elif isinstance(content, AxisYaw):
            outcome = self._gnss.add_heading(self.graph, content)
        else:
            outcome = self._add_scan(content, pending.sensor)
        self._journal.count(pending.sensor, outcome, 1)
        if outcome is Outcome.USED:
            self.monitor.entered(pending.sensor, pending.stamp_ns)
        if outcome is Outcome.LATE:
            self._tell(EventKind.LATE, pending.stamp_ns, pending.sensor, "left the window while it waited")

    def _add_scan(self, scan: Scan, sensor: str) -> Outcome:
        outcome = self.graph.add_scan(scan)
        if self.graph.jumped_ns == scan.stamp_ns:
            assert self._lidar is not None
            often = "; too often: its noise is trebled" if self._lidar.note_jump(scan.stamp_ns) else ""
            self._tell(EventKind.LIDAR_JUMP, scan.stamp_ns, sensor, f"the IMU did not feel this motion{often}")
            self._gnss.forget_track()
        return outcome
