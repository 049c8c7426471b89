"""Coming up: at standstill (checked, not assumed) or in motion; refuses bad data and says why.

A machine that stands starts from gravity and the first source of a heading (`standing_start`). Without a heading it has
to move: then from a batch of positions, IMU and odometry (`fitting_batch`).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from math import inf, radians
from types import MappingProxyType

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import GnssConfig
from holdfast.estimator.batch_clock import REACH_S, Offset
from holdfast.estimator.collected import Collected, between
from holdfast.estimator.compass import Compass
from holdfast.estimator.course import Course, course_of
from holdfast.estimator.far_clocks import FarClocks
from holdfast.estimator.first_heading import Antennas, FirstHeading
from holdfast.estimator.fitting_batch import FittingBatch, FittingBatches
from holdfast.estimator.fixes_in_motion import fixes_in_motion, turn
from holdfast.estimator.found_constants import FoundConstants
from holdfast.estimator.known_biases import KnownBiases
from holdfast.estimator.odometry_tracks import OdometryTracks
from holdfast.estimator.pose_as_point import PoseAsPoint
from holdfast.estimator.standing_start import StandingStart
from holdfast.estimator.velocity_check import Company, VelocityCheck
from holdfast.event_log import EventLog
from holdfast.events import Outcome
from holdfast.graph.alignment import Jump
from holdfast.graph.alignment_problem import Evidence, thin
from holdfast.integrity.consensus import Departure, agreeing, first_of_shape
from holdfast.integrity.exchanges import Exchange, Pair
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array, Message
from holdfast.sensors.clock import is_by_gnss_clock, with_estimated_clock
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.lever_arm import is_in_doubt
from holdfast.sensors.odometry import OdometryNoise
from holdfast.sensors.preintegration import ImuNoise
from holdfast.sensors.sensor import Measurement, Parameter, Position, Role, Sensor, Velocity, is_gnss, of_role
from holdfast.sensors.standstill import ENGINE, quiet_window
from holdfast.state import OptimisedState

PLAUSIBLE_FORCE_M_S2 = (7.0, 13.0)  # mean specific force of a machine on the ground
TIMES_NEARER = 8.0  # to positions, an odometry is than the estimate that leaves them
SILENT_S = 5.0  # is an IMU beside which others have measured later by so much, or it comes in bursts of less
RETRY_NS = 1_000_000_000
COURSE_S = 8.0, 3.0  # over which positions and velocities are averaged: two positions, or all of the shorter time
NO_POSITION, NO_IMU = "no usable position has come", "no usable IMU sample has come"
NO_OTHER = "no usable measurement of a sensor other than the IMU has come"
NO_SENSOR = "no sensor beside the IMU is configured that can start it (needed: positions, poses or an odometry)"


class Initialising:
    """Collects measurements until the first state is certain; `reason` says what is still missing.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        sensors: all models, by name.
        gravity: [m/s^2].
        found: constants of sensors that were found before: where antennas are, and the clock of GNSS.
        clocks: tell by how much stamps are behind the IMU when they arrive.

    Attributes:
        is_contradictory: whether no state explains what the last attempt was made of.
        found: constants that are known to be far from what is configured.
        compass: tells by how much an attitude is beside what is measured.
    """

    def __init__(
        self,
        config: Config,
        buffer: ImuBuffer,
        sensors: Mapping[str, Sensor],
        gravity: float,
        found: Mapping[str, Parameter] = MappingProxyType({}),
        *,
        clocks: FarClocks | None = None,
    ) -> None:
        imu = config.imu
        self._exchanges: list[Exchange] = []
        self._config, self._buffer, self._gravity = config, buffer, gravity
        self._sensors, self.clocks = sensors, clocks or FarClocks(EventLog(config.imu_name))
        self.jump: Jump | None = None  # of the biases, as of the last attempt
        points = of_role(sensors, Role.POSITION)  # those of GNSS first: of another somebody has typed where it stands
        self._points = dict(sorted(points.items(), key=lambda one: not is_gnss(one[1])))
        poses = of_role(sensors, Role.POSE)
        poses = {name: one for name, one in poses.items() if not self._points or not one.parameters}
        self._headings = of_role(sensors, Role.HEADING)
        self._odometries = OdometryTracks(of_role(sensors, Role.ODOMETRY))
        if not self._points:  # W is where the poses are given
            self._points = {name: PoseAsPoint(name) for name in poses}
        antennas = [self._points[name] for name in config.sensors_of(GnssConfig)][:2]
        are_sure = len(antennas) == 2 and not any(is_in_doubt(one.parameters) for one in antennas)
        self._antennas: Antennas | None = (antennas[0], antennas[1]) if are_sure else None
        self._triggers = {one.role for one in of_role(sensors, Role.POSITION, Role.POSE).values()}
        window_ns = round(config.initialisation.window_s * 1e9)
        self._collected = Collected(sensors, self._points, self._odometries, window_ns)
        self.biases = KnownBiases(imu, config.initialisation.standstill_s)
        heading = FirstHeading(config.initialisation, self._collected, self._antennas, self._headings, poses)
        self._standing = StandingStart(
            config, self._collected, gravity, points=self._points, heading=heading, biases=self.biases
        )
        self.misfit = inf  # of the last attempt: squared residuals over what is claimed
        self.is_contradictory = False
        self.doubtful: frozenset[str] = frozenset()  # odometries and receivers that the last attempt has left out
        self._limit_rad = radians(config.initialisation.max_heading_sigma_deg)
        self._velocity_check = VelocityCheck(self._points, of_role(sensors, Role.VELOCITY))
        self.compass = Compass(self._collected, self._antennas, self._headings, self._velocity_check)
        self._last_try_ns = NEVER_NS
        noise = ImuNoise(imu, config.graph.position_integration_sigma, gravity)
        self._batches = FittingBatches(buffer, noise, self._points, of_role(sensors, Role.VELOCITY), self._odometries)
        clock = next((with_estimated_clock(one).parameters[-1] for one in self._points.values() if is_gnss(one)), None)
        self.found = FoundConstants(self._batches, self._collected, clock, self._headings, found)
        has_messages = any(one.message is not None for one in sensors.values())
        self.reason = NO_POSITION if self._points else NO_OTHER if has_messages else NO_SENSOR

    @property
    def waiting_for(self) -> str:
        """Everything that is missing."""
        if self._buffer.latest_ns:
            return self.reason
        return f"{NO_IMU}, and {self.reason}" if self.reason.startswith((NO_POSITION, NO_OTHER, NO_SENSOR)) else NO_IMU

    def add(self, measurement: Measurement) -> bool:
        """Take in a checked measurement; say whether it is one with which a start can be attempted."""
        self._collected.add(measurement)
        role = self._sensors[measurement.sensor].role
        return role in self._triggers or not self._triggers

    @property
    def oldest_ns(self) -> int:
        """Samples of the IMU before this time are of no use."""
        longest_ns = self._collected.longest_ns
        return max(self._collected.newest_ns, self._buffer.latest_ns - longest_ns) - longest_ns

    @property
    def clock_ns(self) -> int:
        """By how much stamps of GNSS are known to be early."""
        return self._collected.clock_ns

    def check_velocities(self) -> None:
        """Leave out sensors of velocity from now on that lead elsewhere than the positions."""
        self._velocity_check.look_back(self._collected.velocities, self._collected.positions)

    @property
    def lying(self) -> frozenset[str]:
        """The sensors of velocity that are left out of a start."""
        return frozenset(self._velocity_check.lying)

    def mistaken(self) -> Collection[str]:
        """Return the sensors of velocity that are late, of another sign or in other axes."""
        self._velocity_check.review(self._collected.velocities, self._collected.positions, self._collected.newest_ns)
        return self._velocity_check.mistaken

    def is_confirmed(self, sensors: Collection[str], since_ns: int, estimate: gtsam.NavState) -> bool:
        """Whether velocities of some sensors lead from before a time to the newest position, not to an estimate."""
        witnesses = self._collected.velocities_of(sensors)
        return self._velocity_check.confirms(witnesses, self._collected.positions, since_ns, estimate)

    def company(self, sensors: Collection[str], receiver: str, since_ns: int) -> Company:
        """Return how a receiver's positions go beside velocities of some sensors, proven before, since a time."""
        witnesses, positions = self._collected.velocities_of(sensors), self._collected.of_receiver(receiver)
        return self._velocity_check.company(witnesses, positions, since_ns)

    def odometry_vouches(self, departure: Departure) -> bool:
        """Whether an odometry has moved in the shape of positions that an estimate leaves."""
        arm = self._points[departure.positions[-1].sensor].p_I_P
        positions, since_ns, by_m = departure
        return self._odometries.move_as(positions, arm, by_m / TIMES_NEARER, since_ns)

    def fixes_vouch_for(self, odometry: str, since_ns: int) -> bool | None:
        """Whether an odometry has moved in the shape of positions from before a time until now; None: too few since."""
        said = []
        for name, point in self._points.items():
            mine = sorted(self._collected.of_receiver(name), key=lambda one: one.stamp_ns)
            positions = mine[first_of_shape([one.stamp_ns for one in mine], since_ns) :]
            said.append(self._odometries.vouched(odometry, positions, point.p_I_P, since_ns))
        if any(said):
            return True
        return None if said and all(one is None for one in said) else False

    @property
    def has_witness(self) -> bool:
        """Whether there are velocities that have proven right, and none of which nothing is known."""
        velocities, check = self._collected.velocities, self._velocity_check
        return bool({one.sensor for one in velocities} & check.proven) and check.are_explained(velocities)

    def forget_before(self, stamp_ns: int) -> None:
        """Forget what was measured before a time."""
        self._collected.forget_before(stamp_ns)
        self._last_try_ns = NEVER_NS

    def forget_ahead(self) -> None:
        """Forget what seems later than the IMU is: before its first sample nobody sees that a clock is far off."""
        self._collected.forget_after(self._buffer.latest_ns + round(SILENT_S * 1e9))

    def forget_older_half(self) -> None:
        """Forget the older half of the time in which positions were measured."""
        stamps = [one.stamp_ns for one in self._collected.positions]
        self.forget_before((min(stamps) + max(stamps)) // 2)

    def settle_arms(self) -> None:
        """Know that the lever arms of antennas are as they were measured."""
        self._batches.settle_arms()

    def forget_odometry(self, name: str) -> None:
        """Forget what an odometry has said, which is not trusted any more."""
        self._odometries.forget(name)

    def weigh_odometries(self, noises: Mapping[str, OdometryNoise]) -> None:
        """Weigh the motions of odometries from now on by noises that learn, by name."""
        self._odometries.weigh_by(noises)

    def believe_jump(self, jump: Jump, bias: gtsam.imuBias.ConstantBias) -> None:
        """Know the biases after they have jumped: what was measured before is forgotten."""
        self.forget_before(jump.stamp_ns)
        self.biases.doubt(bias)

    def refuse(self, message: Message, outcome: Outcome) -> None:
        """Note a message that cannot be used: as long as no position could be, it is the reason."""
        if message.sensor in self._points and not self._collected.positions and self.reason.startswith(NO_POSITION):
            covariance = getattr(message, "covariance", None)
            variance = -1.0 if covariance is None else covariance.diagonal()[:2].max()
            claim = f", it claims {np.sqrt(variance):.3g} m" if variance >= 0.0 else ""
            self.reason = f"{NO_POSITION}; the last of {message.sensor} was refused: {outcome}{claim}"

    def attempt(
        self, *, may_have_jumped: bool = False, may_be_late: bool = True, limit_rad: float = 0.0
    ) -> OptimisedState | None:
        """Return the first state, or None with `reason` set.

        Args:
            may_have_jumped: whether the biases may have jumped since the first position; `jump` tells when.
            may_be_late: then also whether the clock of GNSS may be off.
            limit_rad: sigma of a heading from motion that will do, if it is more than what is configured.
        """
        self.misfit, self.jump, self.doubtful, self.is_contradictory = inf, None, frozenset(), False
        now = self._buffer.latest_ns
        standstill_s = self._config.initialisation.standstill_s
        recent = self._buffer.window(now - round(standstill_s * 1e9), now)
        if recent is None:
            self.reason = f"the IMU has not measured without a gap for {standstill_s:g} s"
            return None
        if (ahead_s := (self._collected.newest_ns - now) * 1e-9) > SILENT_S:
            self.reason = f"others have measured {ahead_s:.1f} s later than the IMU: it is silent, or a clock is wrong"
            return None
        force = float(np.linalg.norm(recent[0].mean(axis=0)))
        if not PLAUSIBLE_FORCE_M_S2[0] < force < PLAUSIBLE_FORCE_M_S2[1]:
            hint = ": is the accelerometer in g? accelerometer_factors makes m/s^2 of it" if 0.8 < force < 1.3 else ""
            self.reason = (
                f"mean specific force is {force:.2f} m/s^2, on the ground it is near {self._gravity:.2f}{hint}"
            )
            return None
        quiet = quiet_window(self._config.standstill, self._buffer, now, standstill_s, ENGINE)
        if quiet is not None and self._standing.is_standing(now):
            return self._at_standstill(now, *quiet)
        limit_rad = max(limit_rad, self._limit_rad)
        return self._in_motion(now, limit_rad, may_have_jumped=may_have_jumped, may_be_late=may_be_late)

    def _at_standstill(self, now_ns: int, force: Array, rate: Array) -> OptimisedState | None:
        state = self._standing.attempt(now_ns, force, rate)
        if isinstance(state, str):
            self.reason = state
            return None
        self.reason, self.misfit = "standstill", 0.0
        return state

    def stands(self, end_ns: int, duration_s: float) -> bool | None:
        """Whether velocities and positions say that the machine stood for so long; None while they cannot tell."""
        return self._standing.stands(end_ns, duration_s)

    def course(self, stamp_ns: int) -> Course | None:
        """Return where positions of the first receiver that agree lead at a time; None without any of late."""
        longest_ns, shortest_ns = (stamp_ns - round(s * 1e9) for s in COURSE_S)
        positions = agreeing(sorted(self._collected.of_first_receiver(longest_ns), key=lambda one: one.stamp_ns))
        positions = positions[-max(sum(one.stamp_ns >= shortest_ns for one in positions), 2) :]
        velocities, _ = self._credible_velocities(positions, max(stamp_ns, self._buffer.latest_ns))
        arm = self._points[positions[-1].sensor].p_I_P if positions else np.zeros(3)
        return course_of(positions, velocities, stamp_ns, arm)

    def specific_force(self, start_ns: int, end_ns: int) -> Array | None:
        """Return the mean specific force (3,) in a time [m/s^2], or None where the IMU was silent in it."""
        held = self._buffer.window(start_ns, end_ns)
        return None if held is None else np.asarray(held[0].mean(axis=0))

    def _in_motion(
        self, now_ns: int, limit_rad: float, *, may_have_jumped: bool, may_be_late: bool
    ) -> OptimisedState | None:
        positions, is_pair = self._collected.positions, may_have_jumped and self._antennas is not None
        fixes = fixes_in_motion(positions, self._points, self._buffer, now_ns, is_pair=is_pair)
        if isinstance(fixes, str):
            self.reason = fixes
            return None
        if not may_have_jumped:
            if fixes[-1].stamp_ns - self._last_try_ns < RETRY_NS:
                return None
            self._last_try_ns = fixes[-1].stamp_ns
        evidence, lying = self._evidence(fixes, now_ns)
        is_explained = may_have_jumped and self._velocity_check.are_explained(self._collected.velocities, lying)
        jump_sigmas = self.biases.doubted if is_explained else None
        late_s = self.clocks.late_s(fixes[-1].sensor) - self.clock_ns * 1e-9 if may_be_late else None
        batch = self._batches.solve(evidence, self.biases.prior, limit_rad, jump_sigmas, late_s)
        if batch.clock is not None and abs(batch.clock.by_s) > REACH_S:  # what it was made of was longer ago than that
            self._know_far_off(batch.clock)
            state = self._in_motion(now_ns, limit_rad, may_have_jumped=may_have_jumped, may_be_late=may_be_late)
            self.reason += f"; stamps of GNSS are {batch.clock}"
            return state
        return self._judged(batch, lying, now_ns)

    def _know_far_off(self, offset: Offset) -> None:
        """Know that stamps of GNSS are early by so much, those that will come, too."""
        by_ns = round(offset.by_s * 1e9)
        self._collected.stamp_later(by_ns)
        self.clocks.move([name for name, one in self._sensors.items() if is_by_gnss_clock(one)], by_ns)
        self.found.know_clock_off(offset._replace(by_s=0.0))

    def attempt_with_moved_antennas(self) -> OptimisedState | None:
        """Return a state if antennas that are elsewhere than configured, or exchanged, explain what was measured."""
        now_ns = self._buffer.latest_ns
        positions, is_pair = self._collected.all_positions, self._antennas is not None
        fixes = fixes_in_motion(positions, self._points, self._buffer, now_ns, is_pair=is_pair)
        if isinstance(fixes, str):
            return None
        evidence, lying = self._evidence(fixes, now_ns)
        prior, limit_rad = self.biases.prior, self._limit_rad
        batch = self._batches.with_exchanged_antennas(evidence, prior, limit_rad)
        if batch is None and self._batches.may_be_moved and turn(fixes):
            batch = self._batches.with_moved_antennas(evidence, prior, limit_rad, self.biases.doubted)
        return None if batch is None else self._judged(batch, lying, now_ns)

    def _evidence(self, fixes: Sequence[Position], now_ns: int) -> tuple[Evidence, list[str]]:
        """Return what a batch is made of, and the sensors of velocity that are left out."""
        velocities, lying = self._credible_velocities(fixes, now_ns)
        return Evidence(fixes, thin(velocities)), lying

    def _judged(self, batch: FittingBatch, lying: Collection[str], now_ns: int) -> OptimisedState | None:
        """Return the state that a batch tells, if it does."""
        alignment, evidence, self.doubtful, shift, offset, pair = batch
        if pair is not None:
            self.exchange(Exchange(pair, headings=self._opposite(pair, alignment.state)))
        if offset is not None:
            self.found.know_clock_off(offset)
        if shift is not None:
            self.found.move_antennas(shift)
        self.misfit, self.jump = alignment.misfit, alignment.jump
        self.is_contradictory = alignment.is_contradictory
        left_out = [*lying, *sorted(self.doubtful)]
        without = f", without {', '.join(left_out)}, at odds with the positions" if left_out else ""
        elsewhere = "" if shift is None else "; the antennas are elsewhere than configured"
        renamed = "" if pair is None else f"; {' and '.join(pair)} are exchanged"
        clock = "" if offset is None else f"; stamps of GNSS are {offset}"
        self.reason = f"{alignment.reason}{without}{elsewhere}{renamed}{clock}"
        if alignment.state is None:
            return None
        if self.jump is not None and alignment.has_jumped:
            by_deg_s, ago_s = np.degrees(self.jump.by_rad_s), (now_ns - self.jump.stamp_ns) * 1e-9
            self.reason += f"; the bias of the gyroscope has jumped by {by_deg_s:.2g} deg/s {ago_s:.0f} s ago"
        return self._by_any_clock(alignment.state, evidence.positions[-1])

    def _opposite(self, pair: Pair, state: OptimisedState | None) -> frozenset[str]:
        """Return the headings from one antenna of a pair to the other that are by half a circle beside a state."""
        if state is None:
            return frozenset()
        between = {name: one for name, one in self._headings.items() if set(pair) == set(one.antennas)}
        newest = self._collected.newest_of(between)
        attitude = state.nav.attitude()
        return frozenset(one.sensor for one in newest if between[one.sensor].is_opposite(one, attitude))

    def exchange(self, exchange: Exchange) -> None:
        """Know that two antennas' positions have come by each other's name."""
        self._collected.exchange(exchange.pair, exchange.since_ns)
        self._exchanges.append(exchange)

    def newly_exchanged(self) -> list[Exchange]:
        """Return the antennas that have been found to be exchanged since this was asked last."""
        found, self._exchanges = self._exchanges, []
        return found

    def _credible_velocities(self, fixes: Sequence[Position], end_ns: int) -> tuple[list[Velocity], list[str]]:
        """Return velocities since the first of some positions, and the sensors that are left out."""
        if not fixes:
            return [], []
        velocities = between(self._collected.velocities, fixes[0].stamp_ns, end_ns)
        erring = self._velocity_check.erring(velocities, fixes)
        return [one for one in velocities if one.sensor not in erring], erring

    def _by_any_clock(self, state: OptimisedState, fix: Position) -> OptimisedState:
        """Return a state in motion that is as uncertain as the clock of the positions that it was found from."""
        sigma_s = float(getattr(self._points[fix.sensor], "offset_sigma_s", 0.0))
        moving = np.concatenate([state.angular_velocity, state.nav.bodyVelocity()]) * sigma_s
        covariance = state.covariance.copy()
        covariance[:6, :6] += np.outer(moving, moving)
        return replace(state, covariance=covariance)
