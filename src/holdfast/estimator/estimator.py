"""The estimator on one page: a message comes in, it is checked, it becomes factors, an estimate goes out."""

from bisect import insort
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.estimator.gate import InnovationGate, innovation_nis
from holdfast.estimator.initializer import Initializer
from holdfast.estimator.predictor import Predictor
from holdfast.estimator.standstill import StandstillUpdates
from holdfast.geometry.earth import Geodetic, LocalFrame, gravity
from holdfast.graph.nodes import Placed
from holdfast.graph.smoother import OptimiserError, Smoother
from holdfast.messages import GnssFix, Heading, ImuSample, LidarPose, Message
from holdfast.sensors.gnss import AntennaPosition, GnssModel
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.lidar import LidarModel
from holdfast.state import Estimate, Event, EventKind, OptimisedState, Outcome

NO_DOUBT = np.zeros((9, 9))
STANDARD_GRAVITY = 9.80665
RECENT = 64  # stamps per sensor among which a duplicate is looked for
MAX_HEADING_SIGMA_RAD = 1.0  # a heading that is less sure says nothing
FUTURE_NS = 1_000_000_000  # further ahead of the IMU's clock a stamp is an error


class Output(NamedTuple):
    """What one message led to: an estimate at an IMU sample, an optimisation, states that will not change any more."""

    estimate: Estimate | None = None
    optimised: OptimisedState | None = None
    smoothed: Sequence[tuple[int, gtsam.NavState]] = ()


class Pending(NamedTuple):
    """A checked measurement that waits until the IMU has reached its time."""

    stamp_ns: int
    order: int
    sensor: str
    content: AntennaPosition | gtsam.Pose3


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
        self._gates = {name: InnovationGate(gnss.gate_sigma) for name, gnss in sensors.antennas().items()}
        lidar = sensors.lidar
        self._lidar = None if lidar is None else LidarModel(lidar, gtsam.Pose3(config.T_I(lidar.frame)))
        self._world: LocalFrame | None = None
        self._initializer: Initializer | None = None
        self._started = False
        self._pending: list[Pending] = []
        self._order = 0
        self._recent: dict[str, deque[int]] = {}
        self._fixes: deque[tuple[Placed, AntennaPosition]] = deque()  # in the window, with their factors
        self._standstill = StandstillUpdates(config.standstill, self._buffer)
        self._last_scan: tuple[int, gtsam.Pose3] | None = None
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

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self.events = self.events, []
        return events

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival."""
        if isinstance(message, ImuSample):
            return self._process_imu(message)
        if isinstance(message, GnssFix):
            return self._process_fix(message)
        if isinstance(message, LidarPose):
            return self._process_lidar(message)
        if isinstance(message, Heading):
            return self._process_heading(message)
        self.counts[message.sensor, Outcome.IGNORED] += 1
        return Output()

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
            self._smoother.mark_silent(self._buffer.gap_found_ns)
        elif stamp - was_heard_ns > self._buffer.max_gap_ns:
            silence = (stamp - was_heard_ns) * 1e-9
            self._tell(EventKind.IMU_GAP, was_heard_ns, sample.sensor, f"no samples for {silence:.3f} s")
        if stamp <= self._predictor.stamp_ns:
            return Output()  # a measurement in a silent stretch has led the state past this sample
        estimate = self._predictor.add(stamp, step)
        ready = self._pending and self._pending[0].stamp_ns <= stamp
        overdue = stamp - self._smoother.newest_ns > self._node_interval_ns
        return self._update(stamp, estimate) if ready or overdue else Output(estimate)

    # --- measurements --------------------------------------------------------------------------------------------

    def _process_fix(self, fix: GnssFix) -> Output:
        model = self._antennas[fix.sensor]
        stamp = fix.stamp_ns + model.offset_ns
        outcome = model.check(fix)
        if outcome is Outcome.USED:
            outcome = self._check_stamp(stamp, fix)
        if outcome is not Outcome.USED:
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
            return self._enqueue(stamp, pose, T_I0_I)
        self.counts[pose.sensor, Outcome.BEFORE_START] += 1
        if self._initializer is not None:
            self._initializer.add_track(stamp, T_I0_I)
            if not self._antennas:
                return self._try_to_start()
        return Output()

    def _process_heading(self, heading: Heading) -> Output:
        config = self.config.sensors.heading
        assert config is not None
        sigma = heading.sigma_rad or float(np.radians(config.default_sigma_deg))
        if not (np.isfinite(heading.yaw_rad) and 0.0 < sigma < np.inf):
            return self._reject(heading, Outcome.NOT_FINITE)
        stamp = heading.stamp_ns + round(config.time_offset_s * 1e9)
        if self._is_future(stamp, heading.arrival_ns):
            return self._reject(heading, Outcome.CLOCK_JUMP)
        if sigma > MAX_HEADING_SIGMA_RAD:
            return self._reject(heading, Outcome.LARGE_COVARIANCE)
        self.counts[heading.sensor, Outcome.IGNORED if self._started else Outcome.BEFORE_START] += 1
        if not self._started and self._initializer is not None:
            yaw = heading.yaw_rad - float(np.radians(config.mounting_yaw_deg))
            self._initializer.add_heading(stamp, yaw, sigma)
        return Output()

    def _check_stamp(self, stamp_ns: int, message: GnssFix | LidarPose) -> Outcome:
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

    def _enqueue(self, stamp_ns: int, message: GnssFix | LidarPose, content: AntennaPosition | gtsam.Pose3) -> Output:
        if stamp_ns < self._smoother.oldest_ns:
            behind = (self._smoother.newest_ns - stamp_ns) * 1e-9
            self.counts[message.sensor, Outcome.LATE] += 1
            self._tell(EventKind.LATE, stamp_ns, message.sensor, f"{behind:.3f} s behind the newest state")
            return Output()
        silence_ns = message.arrival_ns - self._buffer.arrival_ns
        self._order += 1
        insort(self._pending, Pending(stamp_ns, self._order, message.sensor, content))
        heard = self._buffer.latest_ns
        if silence_ns > self._buffer.max_gap_ns:
            heard = max(heard, stamp_ns)  # the IMU is silent: do not wait for it
        return self._update(heard) if self._pending[0].stamp_ns <= heard else Output()

    # --- starting ------------------------------------------------------------------------------------------------

    def _set_datum(self, datum: Geodetic) -> None:
        self._world = LocalFrame(datum)
        self._begin(self.config.frames.gravity or gravity(datum.latitude_deg, datum.altitude_m))

    def _begin(self, g: float) -> None:
        self._gravity = g
        self._initializer = Initializer(self.config, self._buffer, self._antennas, self._lidar, g)
        self._node_interval_ns = round(self.config.graph.max_node_interval_s * 1e9)

    def _try_to_start(self) -> Output:
        assert self._initializer is not None
        before = self._initializer.reason
        state = self._initializer.attempt()
        if state is None:
            if self._initializer.reason != before:
                self._tell(EventKind.WAITING, self._buffer.latest_ns, "", self._initializer.reason)
            return Output()
        self._smoother = Smoother(self.config, self._buffer, self._gravity)
        self._smoother.start(state)
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
        self._fixes.clear()
        self._last_scan, self._started = None, False
        self._standstill = StandstillUpdates(self.config.standstill, self._buffer)
        if self._initializer is not None:
            self._begin(self._gravity)

    # --- optimising ----------------------------------------------------------------------------------------------

    def _update(self, reached_ns: int, estimate: Estimate | None = None) -> Output:
        """Add every measurement whose time the IMU has reached, optimise once, and re-propagate to the present."""
        found_fix = False
        while self._pending and self._pending[0].stamp_ns <= reached_ns:
            pending = self._pending.pop(0)
            found_fix = found_fix or isinstance(pending.content, AntennaPosition)
            self._add(pending)
        if self._buffer.latest_ns - self._smoother.newest_ns > self._node_interval_ns:
            self._smoother.node(self._buffer.latest_ns // self._node_interval_ns * self._node_interval_ns)
        standing = self._standstill.add_to(self._smoother)
        if standing:
            self.counts["standstill", Outcome.USED] += standing
        try:
            state = self._smoother.optimise()
        except OptimiserError as fault:
            self._tell(EventKind.OPTIMISER_FAULT, self._smoother.newest_ns, "", str(fault))
            state = self._smoother.state
            self._last_scan = None
            self._fixes.clear()
        if found_fix:
            self._retract_worst()
        self._predictor.anchor(state)
        self._buffer.forget_before(self._smoother.oldest_ns - self._node_interval_ns)
        return Output(estimate, state, self._smoother.settled())

    def _add(self, pending: Pending) -> None:
        key = self._smoother.node(pending.stamp_ns)
        if key is None:
            self.counts[pending.sensor, Outcome.LATE] += 1
            self._tell(EventKind.LATE, pending.stamp_ns, pending.sensor, "left the window while it waited")
            return
        if isinstance(pending.content, AntennaPosition):
            self._add_fix(key, pending.content)
        else:
            self._add_scan(key, pending)

    def _add_fix(self, key: int, fix: AntennaPosition) -> None:
        model = self._antennas[fix.sensor]
        nav, covariance = self._smoother.nav(fix.stamp_ns), self._smoother.covariance(fix.stamp_ns)
        nis = innovation_nis(nav, covariance, model.p_I_G, fix.p_W_G, fix.covariance)
        inflation = self._gates[fix.sensor].inflation(nis)
        outcome = Outcome.USED
        if inflation is None:
            outcome = Outcome.INNOVATION
            self._tell(EventKind.REJECTED, fix.stamp_ns, fix.sensor, outcome)
            if self._gates[fix.sensor].blames_estimate():
                distance = float(np.linalg.norm(fix.p_W_G - nav.pose().transformFrom(model.p_I_G)))
                self._tell(EventKind.ESTIMATE_SUSPECT, fix.stamp_ns, fix.sensor, f"{distance:.2f} m from the fixes")
                self._smoother.loosen(distance)
                self._fixes.clear()
                self._last_scan = None
        else:
            handle = self._smoother.add(model.factor(key, replace(fix, covariance=fix.covariance * inflation)))
            self._fixes.append((handle, fix))
        self.counts[fix.sensor, outcome] += 1

    def _retract_worst(self) -> None:
        """Take out the fix that later ones contradict most, if its residual is beyond the gate: (21) in docs/math.md.

        A fix that looked plausible when it came may stand alone once its successors are in.
        """
        while self._fixes and self._fixes[0][1].stamp_ns < self._smoother.oldest_ns:
            self._fixes.popleft()
        worst, worst_nis = None, 0.0
        for entry in self._fixes:
            fix = entry[1]
            nav, arm = self._smoother.nav(fix.stamp_ns), self._antennas[fix.sensor].p_I_G
            nis = innovation_nis(nav, NO_DOUBT, arm, fix.p_W_G, fix.covariance)
            if nis > worst_nis:
                worst, worst_nis = entry, nis
        if worst is None or worst is self._fixes[-1]:
            return  # the newest has no successor yet, and may be what pulls at the others
        handle, fix = worst
        if worst_nis > self._gates[fix.sensor].limit:
            self._fixes.remove(worst)
            self._smoother.retract(handle)
            self.counts[fix.sensor, Outcome.USED] -= 1
            self.counts[fix.sensor, Outcome.CONTRADICTED] += 1
            self._tell(EventKind.REJECTED, fix.stamp_ns, fix.sensor, Outcome.CONTRADICTED)

    def _add_scan(self, key: int, scan: Pending) -> None:
        assert self._lidar is not None
        assert isinstance(scan.content, gtsam.Pose3)
        previous, self._last_scan = self._last_scan, (scan.stamp_ns, scan.content)
        outcome = Outcome.NO_PREDECESSOR
        if previous is not None and 0 < scan.stamp_ns - previous[0] <= self._lidar.max_interval_ns:
            previous_key = self._smoother.node(previous[0])
            if previous_key is not None:
                motion = previous[1].between(scan.content)
                outcome = self._lidar.check_motion(motion, (scan.stamp_ns - previous[0]) * 1e-9)
                if outcome is Outcome.USED:
                    self._smoother.add(self._lidar.factor(previous_key, key, motion))
        self.counts[scan.sensor, outcome] += 1

    def _tell(self, kind: EventKind, stamp_ns: int, sensor: str, reason: str) -> None:
        self.event_counts[kind] += 1
        self.events.append(Event(stamp_ns, kind, sensor, reason))
