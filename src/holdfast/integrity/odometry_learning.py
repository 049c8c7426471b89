"""Learns how noisy an odometry is and how fast it drifts, rotation and translation apart: (67) to (70) in docs/math.md.

Noise is what two scans contradict the IMU by, drift what spans of seconds contradict the gyroscope and the fixes by. No
residual is of an estimate that the same number has led: the rotation is compared with the gyroscope alone, the motion
over three scans with the specific force alone, and the distance with that between estimates while GNSS is trusted.
"""

from collections import deque
from math import radians
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.odometry_track import believed_calibration
from holdfast.graph.smoother import Smoother
from holdfast.integrity.clock_trace import ClockTrace
from holdfast.integrity.learnt_snapshot import LOWEST_DRIFT, LOWEST_NOISE, LOWEST_TILT, LearntOdometry
from holdfast.integrity.scale_posterior import ScalePosterior
from holdfast.integrity.yaw_learning import HeadingWitness, YawLearning
from holdfast.messages import Array
from holdfast.sensors.imu import InertialMotion
from holdfast.sensors.odometry import LearntNoise, OdometryNoise, TrackPose

STEP_NS = 1_000_000_000
MAX_STEP_NS = 3 * STEP_NS
TRANSLATION_SPANS, ROTATION_SPANS = (5, 10, 20), (1, 3, 10, 20)  # steps
DRIFT_MEMORY_S, NOISE_MEMORY_SCANS = 600.0, 300
PARTED_SIGMA, PARTED_RAD = 5.0, radians(1.0)  # by which the odometry has turned otherwise than the gyroscope
MOST_WAITING = 64  # poses; more are those of a clock that is believed to be further off than any search finds
DELAY_NS = 20_000_000_000  # what is seen of distances is learnt so much later: until then the fixes may have walked
ATTITUDE_SIGMA_RAD = 1e-3  # of the estimate, at least


class _Step(NamedTuple):
    """What lies between two poses that are about a second apart, the sums since the first of all."""

    by_gyroscope: gtsam.Rot3
    by_odometry: gtsam.Rot3
    drift_variance: float
    gyroscope_variance: float
    turned_rad: Array
    time_s: float


class _Place(NamedTuple):
    """Where the machine was estimated, and where the odometry has carried it since the first place."""

    stamp_ns: int
    p_W_I: Array
    carried_W: Array
    variance: float
    drift_variance: float


class _Evidence(NamedTuple):
    stamp_ns: int
    squared: float
    scaled: float
    other: float
    weight: float


class OdometryLearning:
    """What is learnt of one odometry, as long as one start of the estimator lasts.

    Args:
        noise: of the odometry, which is told what is learnt.
        carried: what was learnt before.

    Attributes:
        clock_trace: whether its clock has stepped.
    """

    def __init__(self, noise: OdometryNoise, carried: LearntOdometry | None = None) -> None:
        self._noise = noise
        self._is_carried = carried is not None
        self._begin(carried or LearntOdometry())
        self._waiting: deque[TrackPose] = deque(maxlen=MOST_WAITING)  # for the IMU to reach when they were measured
        self._scans: deque[tuple[TrackPose, InertialMotion | None]] = deque(maxlen=3)
        self.parts_from_gyroscope = False  # whether it has turned otherwise of late
        self._first: TrackPose | None = None  # of the step that has begun
        self.clock_trace = ClockTrace()
        self._steps: deque[_Step] = deque(maxlen=max(ROTATION_SPANS) + 1)
        self._before: tuple[TrackPose, gtsam.Rot3] | None = None
        self._places: deque[_Place] = deque(maxlen=max(TRANSLATION_SPANS) + 1)
        self._pending: deque[_Evidence] = deque()
        if carried is not None:
            self._tell()

    def _begin(self, before: LearntOdometry) -> None:
        """Begin with what was learnt before: factors on what is configured, not on what is believed of that."""
        scale = self._noise.scale
        self._noises = ScalePosterior(before.rotation_noise, scale), ScalePosterior(before.translation_noise, scale)
        self._drifts = ScalePosterior(before.rotation_drift, scale), ScalePosterior(before.translation_drift, scale)
        self._yaw = YawLearning(self._noise, before.yaw)

    def trust_less(self, factor: float) -> None:
        """The odometry jumps more often than its configured noise explains; what was learnt before knows that."""
        before = self.learnt()
        self._noise.trust_less(factor)
        if self._is_carried:
            self._begin(before)
            self._tell()

    def learnt(self) -> LearntOdometry:
        """Return what was learnt until now, times what is configured."""
        scale = self._noise.scale
        return LearntOdometry(
            rotation_noise=self._noises[0].learnt(scale),
            translation_noise=self._noises[1].learnt(scale),
            rotation_drift=self._drifts[0].learnt(scale),
            translation_drift=self._drifts[1].learnt(scale),
            yaw=self._yaw.learnt(),
        )

    @property
    def gyroscope_scale(self) -> float:
        """How many times larger the gyroscope's noise is than configured, about the vertical."""
        return self._yaw.gyroscope_scale

    def forget_frame(self) -> None:
        """The odometry has jumped, or the estimate: nothing before is to be compared with what comes."""
        self._waiting.clear()
        self._scans.clear()
        self._forget_steps()
        self._places.clear()
        self._first = self._before = None
        self.clock_trace.clear()

    def forget_after(self, stamp_ns: int) -> None:
        """The estimate went astray after a time."""
        self._places.clear()
        self._before = None
        while self._pending and self._pending[-1].stamp_ns > stamp_ns:
            self._pending.pop()

    def _forget_steps(self) -> None:
        self.parts_from_gyroscope = False
        self._steps.clear()
        self._yaw.begin_anew()

    def learn_from_scan(self, smoother: Smoother, pose: TrackPose, witness: HeadingWitness) -> None:
        """Compare a pose, which is the newest and has a node, with the IMU since the poses before.

        If its stamp is early, the IMU has not reached yet when it was measured: then the next poses call for that.
        """
        self._waiting.append(pose)
        believed = believed_calibration(smoother, pose.sensor, self._noise.calibration)
        while self._waiting and self._waiting[0].claimed_ns + _early_ns(believed) <= smoother.imu.latest_ns:
            self._compare(smoother, self._waiting.popleft(), witness, believed)

    def _compare(self, smoother: Smoother, pose: TrackPose, witness: HeadingWitness, believed: Array) -> None:
        """Compare a pose with the IMU, which has measured until then, since the poses before.

        `believed` (8,) is what is believed of how the odometry is mounted, of its scale and its clock.
        """
        before = self._scans[-1][0] if self._scans else None
        measured = None
        if before is not None:
            if pose.claimed_ns <= before.claimed_ns:
                return
            measured = _measured(smoother, before, pose, believed)
        self._scans.append((pose, measured))
        if before is None or measured is None:
            self._forget_steps()
            self._first = pose
            return
        motion = self._motion(before, pose, believed)
        self._compare_rotation(motion, (pose.claimed_ns - before.claimed_ns) * 1e-9, measured, smoother)
        if len(self._scans) == 3:
            self._compare_translation(smoother, believed)
        for posterior in self._noises:
            posterior.forget(1.0 / NOISE_MEMORY_SCANS)
        if self._first is not None and pose.claimed_ns - self._first.claimed_ns >= STEP_NS:
            self._add_step(smoother, self._first, pose, witness, believed)
            self._first = pose
        self._tell()

    def learn_from_place(
        self, pose: TrackPose, T_W_I: gtsam.Pose3, covariance: Array, calibration: Array, now_ns: int
    ) -> None:
        """Compare where GNSS has led the estimate at a pose with where the odometry has carried it; once a second.

        `covariance` (9, 9) is that of its node, `calibration` (8,) what is believed of the odometry.
        """
        before, self._before = self._before, (pose, T_W_I.rotation())
        variance = float(covariance[3:6, 3:6].trace()) / 3.0
        if before is None or not 0 < pose.stamp_ns - before[0].stamp_ns <= MAX_STEP_NS:
            self._places.clear()
            self._places.append(_Place(pose.stamp_ns, T_W_I.translation(), np.zeros(3), variance, 0.0))
            return
        motion = self._motion(before[0], pose, calibration)
        last = self._places[-1]
        drift = self._noise.drift(motion, (pose.stamp_ns - before[0].stamp_ns) * 1e-9)[3]
        carried = last.carried_W + before[1].rotate(motion.translation())
        here = _Place(pose.stamp_ns, T_W_I.translation(), carried, variance, last.drift_variance + float(drift) ** 2)
        self._places.append(here)
        attitude_variance = max(float(covariance[:3, :3].trace()) / 3.0, ATTITUDE_SIGMA_RAD**2)
        for span in TRANSLATION_SPANS:
            if len(self._places) > span:
                self._pending.append(self._evidence(self._places[-1 - span], here, attitude_variance, span))
        while self._pending and now_ns - self._pending[0].stamp_ns > DELAY_NS:
            one = self._pending.popleft()
            self._drifts[1].learn(one.squared, 3, one.scaled, one.other, one.weight)
        self._drifts[1].forget((pose.stamp_ns - before[0].stamp_ns) * 1e-9 / DRIFT_MEMORY_S)
        self._tell()

    def _evidence(self, then: _Place, here: _Place, attitude_variance: float, span: int) -> _Evidence:
        carried, moved = here.carried_W - then.carried_W, here.p_W_I - then.p_W_I
        of_poses = self._noise.learnt.translation_noise**2 * 2.0 * self._noise.pose_variances()[1]
        other = then.variance + here.variance + of_poses + attitude_variance * float(carried @ carried)
        residual = moved - carried
        scaled = here.drift_variance - then.drift_variance
        return _Evidence(here.stamp_ns, float(residual @ residual), scaled, other, 1.0 / span)

    def _motion(self, then: TrackPose, now: TrackPose, believed: Array) -> gtsam.Pose3:
        """Return how the odometry has moved between two poses, mounted as is believed."""
        return self._noise.calibration.motion(then.T_I0_I.between(now.T_I0_I), believed)

    def _compare_rotation(
        self, motion: gtsam.Pose3, duration_s: float, measured: InertialMotion, smoother: Smoother
    ) -> None:
        """Compare the rotation between two scans with that of the gyroscope: (68)."""
        turned, residual = gtsam.Rot3(measured.R), _beyond(measured, motion)
        drift = self._drifts[0].value * float(self._noise.drift(motion, duration_s)[0])
        other = drift**2 + _gyroscope_variance(smoother, motion, duration_s)
        other += _mean_variance(smoother.turning_covariance(gtsam.Rot3.Logmap(turned)))
        self._noises[0].learn(float(residual @ residual), 3, 2.0 * self._noise.pose_variances()[0], other, 0.5)

    def _compare_translation(self, smoother: Smoother, believed: Array) -> None:
        """Compare how the velocity changes between the middles of two intervals with the specific force: (69)."""
        (first, _), (middle, to_middle), (last, to_last) = self._scans
        if to_middle is None or to_last is None or not smoother.has_node(middle.stamp_ns):
            return
        dts = (middle.claimed_ns - first.claimed_ns) * 1e-9, (last.claimed_ns - middle.claimed_ns) * 1e-9
        dt_1, dt_2 = dts
        gravity = smoother.nav(middle.stamp_ns).attitude().unrotate(np.array([0.0, 0.0, -smoother.imu_noise.gravity]))
        lever = self._noise.calibration.lever_arm
        by_imu = 0.5 * gravity * (dt_1 + dt_2) + (to_last.p + to_last.R @ lever - lever) / dt_2
        by_imu += to_middle.R.T @ (to_middle.v - (to_middle.p + to_middle.R @ lever - lever) / dt_1)
        motions = self._motion(first, middle, believed), self._motion(middle, last, believed)
        moved_1, moved_2 = (motion.transformFrom(lever) - lever for motion in motions)
        residual = moved_2 / dt_2 - motions[0].rotation().unrotate(moved_1) / dt_1 - by_imu
        weights = dt_2**-2 + (1.0 / dt_1 + 1.0 / dt_2) ** 2 + dt_1**-2
        scaled = self._noise.pose_variances()[1] * weights
        other = sum(float(self._noise.drift(one, dt_s)[3] / dt_s) ** 2 for one, dt_s in zip(motions, dts, strict=True))
        other *= self._drifts[1].value ** 2
        other += smoother.imu_noise.density.accelerometer**2 * (dt_1 + dt_2)
        self._noises[1].learn(float(residual @ residual), 3, scaled, other, 1.0 / 3.0)

    def _add_step(
        self, smoother: Smoother, first: TrackPose, last: TrackPose, witness: HeadingWitness, believed: Array
    ) -> None:
        """Compare rotations over seconds with those of the gyroscope: (70)."""
        measured = _measured(smoother, first, last, believed)
        if measured is None:
            self._forget_steps()
            return
        motion = self._motion(first, last, believed)
        if smoother.has_node(first.stamp_ns):
            said = witness(smoother, last.stamp_ns)
            self._yaw.learn(smoother, first, last, motion, measured_R=measured.R, witness=said)
        duration_s = (last.claimed_ns - first.claimed_ns) * 1e-9
        before = self._steps[-1] if self._steps else _Step(gtsam.Rot3(), gtsam.Rot3(), 0.0, 0.0, np.zeros(3), 0.0)
        if not self._steps:
            self._steps.append(before)
        self._trace_clock(smoother, first, last, _beyond(measured, motion), believed)
        turned = gtsam.Rot3(measured.R)
        step = _Step(
            before.by_gyroscope * turned,
            before.by_odometry * motion.rotation(),
            before.drift_variance + float(self._noise.drift(motion, duration_s)[0]) ** 2,
            before.gyroscope_variance + _gyroscope_variance(smoother, motion, duration_s),
            before.turned_rad + gtsam.Rot3.Logmap(turned),
            before.time_s + duration_s,
        )
        self._steps.append(step)
        of_poses = self._noise.learnt.rotation_noise**2 * 2.0 * self._noise.pose_variances()[0]
        self.parts_from_gyroscope = False
        for span in ROTATION_SPANS:
            if len(self._steps) > span:
                then = self._steps[-1 - span]
                by_gyroscope = then.by_gyroscope.between(step.by_gyroscope)
                residual = gtsam.Rot3.Logmap(by_gyroscope.between(then.by_odometry.between(step.by_odometry)))
                other = step.gyroscope_variance - then.gyroscope_variance + of_poses
                turned_rad, time_s = step.turned_rad - then.turned_rad, step.time_s - then.time_s
                other += _mean_variance(smoother.turning_covariance(turned_rad, time_s))
                scaled = step.drift_variance - then.drift_variance
                squared = float(residual @ residual)
                expected = self._drifts[0].value ** 2 * scaled + other
                self.parts_from_gyroscope |= squared > max(PARTED_SIGMA**2 * expected, PARTED_RAD**2)
                self._drifts[0].learn(squared, 3, scaled, other, 1.0 / span)
        self._drifts[0].forget(duration_s / DRIFT_MEMORY_S)

    def watch_clock(self, smoother: Smoother, first: TrackPose, last: TrackPose) -> None:
        """Trace the clock alone, from two poses about a second apart: while it is off nothing else can be told."""
        believed = believed_calibration(smoother, last.sensor, self._noise.calibration)
        measured = _measured(smoother, first, last, believed)
        if measured is None:
            self.clock_trace.clear()
        else:
            motion = self._motion(first, last, believed)
            self._trace_clock(smoother, first, last, _beyond(measured, motion), believed)

    def _trace_clock(
        self, smoother: Smoother, first: TrackPose, last: TrackPose, beyond: Array, believed: Array
    ) -> None:
        rates = (smoother.imu.angular_velocity(one.claimed_ns + _early_ns(believed)) for one in (last, first))
        self.clock_trace.add(beyond, np.subtract(*rates), float(believed[-1]))

    def _tell(self) -> None:
        """Let the factors know what was learnt."""
        self._noise.learnt = LearntNoise(
            max(LOWEST_NOISE, self._noises[0].value),
            max(LOWEST_NOISE, self._noises[1].value),
            max(LOWEST_TILT, self._drifts[0].value),
            max(LOWEST_DRIFT, self._drifts[1].value),
            self._yaw.odometry_scale,
        )


def _early_ns(believed: Array) -> int:
    """Return by how much the stamps of an odometry are early, by what is believed (8,) of it."""
    return round(float(believed[-1]) * 1e9)


def _measured(smoother: Smoother, first: TrackPose, last: TrackPose, believed: Array) -> InertialMotion | None:
    """Return what the IMU measured between two poses of an odometry; None where it did not measure all along."""
    imu, early_ns = smoother.imu, _early_ns(believed)
    start_ns, end_ns = first.claimed_ns + early_ns, last.claimed_ns + early_ns
    if end_ns - start_ns > MAX_STEP_NS or not imu.is_trusted(start_ns, end_ns):
        return None
    return imu.motion(start_ns, end_ns, smoother.seen_bias(imu.turning(start_ns, end_ns)).vector())


def _beyond(measured: InertialMotion, motion: gtsam.Pose3) -> Array:
    """Return by how much (3,) an odometry has turned further than the gyroscope [rad]."""
    beyond: Array = gtsam.Rot3.Logmap(gtsam.Rot3(measured.R).between(motion.rotation()))
    return beyond


def _gyroscope_variance(smoother: Smoother, motion: gtsam.Pose3, duration_s: float) -> float:
    """Return the variance [rad^2] per axis of the gyroscope's rotation over a motion, constant errors left out."""
    rotation_rad = float(np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation())))
    return smoother.imu_noise.rotation_variance(rotation_rad, duration_s)


def _mean_variance(covariance: Array) -> float:
    return float(np.trace(covariance)) / len(covariance)
