"""Odometries on their way into both graphs: which jump, slip, lie or fall silent, and what they say against GNSS."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from math import degrees
from types import MappingProxyType
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.odometry_track import OdometryTrack, believed_calibration
from holdfast.integrity.drift_monitor import Contradiction
from holdfast.integrity.far_delay import DateLater, told
from holdfast.integrity.learnt_snapshot import LearntOdometry
from holdfast.integrity.monitored_odometry import DISTRUST, Jumps, MonitoredOdometry
from holdfast.integrity.odometry_trust import AGREES_M, AGREES_RAD, Watched
from holdfast.integrity.yaw_learning import HeadingWitness
from holdfast.messages import Array
from holdfast.sensors.constants import length_and_sigma
from holdfast.sensors.odometry import OdometryModel, OdometryNoise, TrackPose
from holdfast.sensors.scale import CHANGE as SCALE_CHANGE
from holdfast.sensors.sensor import Parameter

NOT_MEASURED = "the IMU did not measure its motions, one after another"
STUCK = "it says the same pose again and again, though the machine has moved"
TURNED = "its motions beside the fixes turn its mount further than the configuration is known to be wrong"
ERRS_NS = 5_000_000_000  # for so long a gyroscope is doubted


FixWitness = Callable[[str, int], bool | None]
"""Tells whether an odometry has moved as the fixes since a time [ns]; None while too few have come."""


class Walk(NamedTuple):
    """Fixes that walked away, as an odometry that can be trusted says."""

    odometry: str
    pose: TrackPose
    found: Contradiction


class Odometries:
    """All odometries of one machine, each with its own track, noise and drift.

    Args:
        config: of the estimator.
        models: by name.
        log: where counts and events go.
        headings: what they say of the heading of an estimate.
        fixes: whether they say the same as an odometry.
        date_later: reads stamps of sensors as so much later [ns], those that will come.
        carried: what was learnt of odometries before, by name.
    """

    def __init__(
        self,
        config: Config,
        models: dict[str, OdometryModel],
        log: EventLog,
        *,
        headings: HeadingWitness,
        fixes: FixWitness,
        date_later: DateLater,
        carried: Mapping[str, LearntOdometry] = MappingProxyType({}),
    ) -> None:
        self._odometries = {name: MonitoredOdometry(model, carried.get(name)) for name, model in models.items()}
        self._mode = config.graph.main_odometry
        self._is_monitored = config.gate.drift_monitor
        self._log = log
        self._headings, self._fixes, self._date_later = headings, fixes, date_later
        self._has_turned = False
        self._mounts: dict[str, Parameter] = {}  # priors of those that are mounted otherwise than configured

    def __len__(self) -> int:
        return len(self._odometries)

    @property
    def noises(self) -> dict[str, OdometryNoise]:
        """What the motion of each weighs, by name."""
        return {name: one.noise for name, one in self._odometries.items()}

    def learnt(self) -> dict[str, LearntOdometry]:
        """Return what was learnt of each."""
        return {name: one.learning.learnt() for name, one in self._odometries.items()}

    def new_tracks(self) -> dict[str, OdometryTrack]:
        """Return an empty track of each odometry for a new graph."""
        return {
            name: OdometryTrack(one.noise, one.model.max_interval_ns, self._mode)
            for name, one in self._odometries.items()
        }

    def lost(self) -> list[str]:
        """Return the odometries that fell silent or are not trusted."""
        return [name for name, one in self._odometries.items() if one.is_lost]

    @property
    def carry(self) -> bool:
        """Whether one of them is trusted, and carries the estimate from fix to fix."""
        return any(not one.is_lost for one in self._odometries.values())

    @property
    def distrusted(self) -> frozenset[str]:
        """The odometries that are not trusted."""
        return frozenset(name for name, one in self._odometries.items() if one.trust.is_lost)

    def has_held(self, since_ns: int) -> bool:
        """Whether any odometry that is trusted has held the estimate since a time: its track has not broken."""
        return any(not one.trust.is_lost and one.broken_ns < since_ns for one in self._odometries.values())

    def distrust(self, names: Collection[str]) -> None:
        """Trust those odometries no more that are among some sensors."""
        for name, one in self._odometries.items():
            if name in names:
                one.trust.lose()

    def dated(self, pose: TrackPose) -> TrackPose:
        """Return a pose, its stamp corrected by what is known of the clock."""
        return pose.dated(self._odometries[pose.sensor].early_ns)

    def add(self, graph: DualGraph, pose: TrackPose, now_ns: int) -> Outcome:
        """Join a pose to its track in the graphs; a jump begins a new frame."""
        odometry = self._odometries[pose.sensor]
        self._look_whether_seconds_off(graph, odometry, pose)
        if odometry.trust.is_lost:
            outcome = self._watch(graph, odometry, pose, now_ns)
            self._log.record(pose.stamp_ns, pose.sensor, outcome)
            return outcome
        before = graph.newest_pose(pose.sensor)
        is_measured = before is None or graph.main.imu.is_trusted(before.stamp_ns, pose.stamp_ns)
        is_doubtful = odometry.trust.lies_since_ns is not None and not is_measured  # nobody can say that it has ended
        if is_doubtful:
            odometry.forget_frame()
        outcome, jump = graph.add_pose(replace(pose, begins_anew=True) if is_doubtful else pose)
        odometry.is_stuck = outcome is Outcome.FROZEN
        if outcome is Outcome.USED:
            odometry.hear(now_ns)
            if odometry.is_silent:
                odometry.is_silent = False
                self._log.report(EventKind.SENSOR_REGAINED, now_ns, pose.sensor, "poses again")
        if pose.begins_anew:
            reason = "it begins a new map: the motion since the pose before is not measured"
            self._log.report(EventKind.ODOMETRY_JUMP, pose.stamp_ns, pose.sensor, reason)
            odometry.break_track(now_ns)
        if not is_doubtful:
            odometry.trust.note_motion(pose.stamp_ns, jump)
        seems_since_ns = odometry.trust.lies_since_ns
        lies_since_ns = self._unless_fixes_agree(graph, odometry, pose, seems_since_ns, now_ns)
        jumps = Jumps.FEW if jump is None or seems_since_ns is not None else odometry.note_jump(pose.stamp_ns)
        if jump is not None:
            trebled = "" if jumps is Jumps.FEW else "; too often: its noise is trebled"
            reason = f"the IMU did not measure this motion{trebled}"
            self._log.report(EventKind.ODOMETRY_JUMP, pose.stamp_ns, pose.sensor, reason)
            odometry.break_track(now_ns)
        if jumps is Jumps.WILD:
            lies_since_ns = pose.stamp_ns
        reason = NOT_MEASURED
        may_be_turned = lies_since_ns is None and is_measured and not graph.is_lost
        if may_be_turned and self._is_turned(graph, odometry, pose.sensor):
            lies_since_ns, reason, self._has_turned = graph.main.oldest_ns, TURNED, True
            self._mount(graph, pose.sensor, odometry.model.calibration.prior_about(np.zeros(3), AGREES_RAD))
        if lies_since_ns is not None:
            self._log.record(pose.stamp_ns, pose.sensor, outcome)
            self._lose(graph, pose.sensor, lies_since_ns, now_ns, reason)
            return outcome
        if pose.excess is not None:
            odometry.forget_frame()  # it does not know its motion: it cannot contradict, nor be learnt from
        elif outcome is Outcome.USED and pose is graph.newest_pose(pose.sensor):
            self._learn(graph, odometry, pose)
        self._log.record(pose.stamp_ns, pose.sensor, outcome)
        return outcome

    def _unless_fixes_agree(
        self, graph: DualGraph, odometry: MonitoredOdometry, pose: TrackPose, since_ns: int | None, now_ns: int
    ) -> int | None:
        """Return since when an odometry lies, that the IMU contradicts since a time; None while fixes may yet tell."""
        if since_ns is None:
            return None
        moves_as_fixes = self._fixes(pose.sensor, since_ns)
        if moves_as_fixes:
            odometry.contradicts_ns = now_ns
        return None if moves_as_fixes or (moves_as_fixes is None and not graph.is_lost) else since_ns

    def _is_turned(self, graph: DualGraph, odometry: MonitoredOdometry, name: str) -> bool:
        calibration = odometry.model.calibration
        if calibration.prior is None or not calibration.is_mount_estimated:
            return False
        prior = graph.main.parameters.prior(name, calibration.prior)
        return calibration.is_turned(prior, self._calibration(graph, name))

    def _mount(self, graph: DualGraph, name: str, prior: Parameter) -> None:
        """Know no more of how an odometry is mounted from now on, and after the estimate has begun anew."""
        self._mounts[name] = prior
        graph.begin_parameter_anew(name, prior)

    def _learn(self, graph: DualGraph, odometry: MonitoredOdometry, pose: TrackPose) -> None:
        """Learn from a pose that has joined its track, which is the newest."""
        odometry.learning.learn_from_scan(graph.main, pose, self._headings)
        # an error of the gyroscope shows against each of them
        graph.main.imu_noise.yaw_scale = min(one.learning.gyroscope_scale for one in self._odometries.values())
        self._follow_clock(graph, odometry, pose.sensor)
        if (prior := odometry.model.calibration.prior) is not None:
            known, covariance = graph.main.parameters.belief(pose.sensor, prior)
            odometry.know_clock(float(known[-1]), float(covariance[-1, -1]) ** 0.5)

    def _follow_clock(self, graph: DualGraph, odometry: MonitoredOdometry, name: str) -> None:
        """Know of an odometry whose clock has stepped that it is another one from now on."""
        calibration, early_s = odometry.model.calibration, odometry.learning.clock_trace.stepped_s
        if calibration.prior is None or early_s is None:
            return
        known, covariance = graph.main.parameters.belief(name, calibration.prior)
        reason = f"its stamps are {abs(early_s):.2f} s {'early' if early_s > 0.0 else 'late'} now"
        self._log.report(EventKind.CLOCK_STEP, graph.main.newest_ns, name, reason)
        self._mount(graph, name, calibration.prior_by_clock(known, np.sqrt(covariance.diagonal()), early_s))
        graph.begin_tracks_anew(name)
        odometry.forget_frame()

    def go_on_from(self, graph: DualGraph, before: "Odometries") -> None:
        """Begin with what was found of mounts, and of noise that is larger than configured, before all began anew."""
        for name, one in before._odometries.items():
            self._odometries[name].learning.trust_less(one.noise.scale)
        for name, prior in before._mounts.items():
            self._mount(graph, name, prior)

    def _watch(self, graph: DualGraph, odometry: MonitoredOdometry, pose: TrackPose, now_ns: int) -> Outcome:
        """Compare how an odometry that is not trusted moves with how the estimate does, with fixes if there are any."""
        odometry.hear(now_ns)
        odometry.is_silent = False
        before, main = odometry.trust.watched, graph.main
        if odometry.trust.is_due(pose) and main.node(pose.stamp_ns) is not None:
            seen = None
            if before is not None and main.has_node(before.stamp_ns):
                seen = Watched(before, self.estimated(graph, before), main.covariance(before.stamp_ns))
                odometry.learning.watch_clock(main, before, pose)
                self._follow_clock(graph, odometry, pose.sensor)
            if odometry.trust.watch(pose, seen, self._calibration(graph, pose.sensor), is_led=not graph.is_lost):
                reason = "it moves as the estimate again"
                if (mount := odometry.trust.mount) is not None:
                    self._mount(graph, pose.sensor, odometry.model.calibration.prior_about(mount))
                    off_deg = degrees(float(np.linalg.norm(mount)))
                    reason = f"mounted {off_deg:.0f} deg otherwise than configured it moves as the estimate"
                self._log.report(EventKind.SENSOR_REGAINED, now_ns, pose.sensor, reason)
        return Outcome.QUARANTINED

    def _look_whether_seconds_off(self, graph: DualGraph, odometry: MonitoredOdometry, pose: TrackPose) -> None:
        """Read the stamps of an odometry by another clock, if it turns as the machine did seconds ago.

        What was believed of it was by a clock that was not its own: it is watched before it is trusted again.
        """
        if not odometry.may_be_seconds_off or (delay_s := odometry.turn_rates.delay_s(graph.main, pose)) is None:
            return
        name, calibration = pose.sensor, odometry.model.calibration
        self._log.report(EventKind.CALIBRATION, pose.stamp_ns, name, told(delay_s))
        self._date_later([name], -round(delay_s * 1e9))
        odometry.begin_anew()
        graph.begin_tracks_anew(name)
        self._mounts.pop(name, None)
        for prior in calibration.prior, calibration.arm_prior, calibration.scale_prior:
            if prior is not None:
                graph.begin_parameter_anew(prior.name(name), prior)

    def _lose(self, graph: DualGraph, name: str, since_ns: int, now_ns: int, reason: str) -> None:
        """Trust an odometry no more, and take out what it has said since a time."""
        self._odometries[name].lose()
        for smoother in graph.smoothers():
            for one in smoother.measured(since_ns, now_ns):
                if one.sensor == name:
                    smoother.retract(one)
                    if smoother is graph.main:
                        self._log.recount(name, Outcome.USED, Outcome.CONTRADICTED)
                        self._log.record(one.stamp_ns, name, Outcome.CONTRADICTED)
        graph.begin_tracks_anew(name)
        self._forget_shape(graph, name)
        self._log.report(EventKind.SENSOR_LOST, now_ns, name, reason)

    def _forget_shape(self, graph: DualGraph, name: str) -> None:
        """Forget place and scale of an odometry if they were not known yet: its lies may have looked like them."""
        calibration = self._odometries[name].model.calibration
        for prior, enough in ((calibration.arm_prior, AGREES_M), (calibration.scale_prior, SCALE_CHANGE)):
            known = None if prior is None else graph.main.parameters.estimate(prior.name(name))
            if prior is not None and known is not None and length_and_sigma(*known)[1] > enough:
                graph.begin_parameter_anew(prior.name(name), prior)

    def pass_over(self, gap_ns: int) -> None:
        """Know that the IMU has not measured for so long."""
        for one in self._odometries.values():
            one.pass_over(gap_ns)

    def review(self, now_ns: int) -> None:
        """Lose the odometries that are silent."""
        for name, one in self._odometries.items():
            if not one.is_silent and one.falls_silent(now_ns):
                one.is_silent = True
                self._log.report(EventKind.SENSOR_LOST, now_ns, name, STUCK if one.is_stuck else "silent")

    def find_walk(self, graph: DualGraph, now_ns: int) -> Walk | None:
        """Compare where each odometry sees the machine with where GNSS has led the estimate.

        Where another odometry agrees with GNSS, or where fixes hardly walk so fast, it is the odometry that slipped.
        """
        if not self._is_monitored:
            return None
        for name, pose in self._due(graph):
            covariance, calibration = graph.main.covariance(pose.stamp_ns), self._calibration(graph, name)
            monitor = self._odometries[name].monitor
            T_W_I = self.estimated(graph, pose)
            self._odometries[name].learning.learn_from_place(pose, T_W_I, covariance, calibration, now_ns)
            found = monitor.observe(pose, T_W_I, covariance, calibration)
            if found is None:
                continue
            others = [one.monitor for other, one in self._odometries.items() if other != name]
            parts_from_gyroscope = self._odometries[name].learning.parts_from_gyroscope
            if not found.is_slip and not any(one.vouches(found.since_ns, now_ns) for one in others):
                if parts_from_gyroscope:
                    continue  # fixes that walk turn nothing
                return Walk(name, pose, found)
            moves_as_fixes = self._fixes(name, found.since_ns)
            if moves_as_fixes:
                self._odometries[name].contradicts_ns = now_ns
            if moves_as_fixes or (moves_as_fixes is None and parts_from_gyroscope):
                continue  # which of the two is wrong, the next fixes say
            self._odometries[name].break_track(now_ns)
            beside = f"{found.distance_m:.2f} m beside GNSS"
            self._log.report(EventKind.ODOMETRY_SLIP, now_ns, name, beside)
            if self._odometries[name].trust.note_slip(now_ns, found.distance_m, found.moved_m):
                self._lose(graph, name, found.since_ns, now_ns, f"it slips again, {beside}")
            else:
                graph.begin_tracks_anew(name, within=graph.main)
        return None

    def estimated(self, graph: DualGraph, pose: TrackPose) -> gtsam.Pose3:
        """Return where the main graph sees the machine when a pose was measured, by what it knows of its clock."""
        state, constants = graph.main.mean_at(pose.stamp_ns), self._calibration(graph, pose.sensor)
        left_s = float(constants[-1]) - pose.early_ns * 1e-9
        return self._odometries[pose.sensor].model.calibration.after(
            state.nav, state.angular_velocity, left_s, state.twist_beyond(left_s)
        )

    def has_agreed(self) -> bool:
        """Whether one that is still there has agreed with GNSS since the start: then the estimate was right, once."""
        return any(one.monitor.has_agreed for one in self._odometries.values() if not one.is_lost)

    def newly_turned(self) -> bool:
        """Whether one has turned its mount, and the estimate with it, since this was asked last."""
        before, self._has_turned = self._has_turned, False
        return before

    def part_from_gyroscope(self, now_ns: int) -> bool:
        """Whether all that are trusted have of late turned otherwise than the gyroscope, by far, or fixes say so.

        What is late turns otherwise, too, where the rate changes.
        """
        trusted = [one for one in self._odometries.values() if not one.is_lost]
        parted = (one.parts_from_gyroscope or now_ns - one.contradicts_ns < ERRS_NS for one in trusted)
        return bool(trusted) and all(parted)

    def forget_frames(self) -> None:
        """The estimate has jumped, or the graph lost its window."""
        for one in self._odometries.values():
            one.forget_frame()

    def forget_after(self, stamp_ns: int) -> None:
        """The estimate went astray after a time, and is now put back."""
        for one in self._odometries.values():
            one.monitor.forget_after(stamp_ns)
            one.learning.forget_after(stamp_ns)

    def trust_less(self) -> None:
        """The odometries have held an estimate against fixes that were right."""
        for one in self._odometries.values():
            one.noise.trust_less(DISTRUST)

    def _due(self, graph: DualGraph) -> Iterator[tuple[str, TrackPose]]:
        for name, one in self._odometries.items():
            pose = None if one.trust.is_lost else graph.newest_pose(name)
            if pose is not None and pose.stamp_ns >= graph.main.oldest_ns and one.monitor.is_due(pose):
                yield name, pose

    def _calibration(self, graph: DualGraph, odometry: str) -> Array:
        """Return what the main graph estimates of an odometry (8,): its mounting, lever arm, scale and clock."""
        return believed_calibration(graph.main, odometry, self._odometries[odometry].model.calibration)
