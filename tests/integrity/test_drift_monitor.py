"""The drift monitor: silent while the odometry drifts as it may, alarmed when the fixes walk away."""

from functools import partial

import gtsam
import numpy as np
import pytest

from holdfast.config.sensors import OdometryConfig
from holdfast.integrity.drift_monitor import FRESH_NS, DriftMonitor
from holdfast.sensors.odometry import OdometryModel, OdometryNoise, TrackPose

CONFIG = OdometryConfig(kind="odometry", topic="/lidar")
KNOWN = np.diag(np.repeat([0.002, 0.01, 0.01], 3) ** 2)
SPEED_M_S = 1.5


def pose_at(t_s, speed_m_s=SPEED_M_S):
    """A circle of 20 m radius."""
    angle = speed_m_s * t_s / 20.0
    position = np.array([20.0 * np.sin(angle), 20.0 * (1.0 - np.cos(angle)), 0.0])
    return gtsam.Pose3(gtsam.Rot3.Yaw(angle), position)


def nothing(_t):
    return np.zeros(3)


def new_monitor():
    noise = OdometryNoise(OdometryModel("lidar", CONFIG, gtsam.Pose3()))
    return DriftMonitor(noise), noise


def watch(seconds, walk=nothing, rng=None, *, slip_from_s=np.inf, drift=1.0, at=pose_at, monitor=None):
    """What the monitor finds each second: the odometry drifts as configured times `drift`, GNSS walks."""
    fresh, noise = new_monitor()
    monitor = monitor or fresh
    track, before, found = gtsam.Pose3(), at(0.0), []
    for t in np.arange(0.0, seconds, 1.0):
        here = at(t)
        motion = before.between(here)
        if rng is not None:
            sigmas = drift * noise.drift(motion, 1.0)
            motion = motion * gtsam.Pose3.Expmap(rng.normal(0.0, sigmas))
        slip = gtsam.Pose3(gtsam.Rot3(), np.array([-1.0 if t > slip_from_s else 0.0, 0.0, 0.0]))
        before, track = here, track * motion * slip
        error = np.zeros(3) if rng is None else rng.normal(0.0, 0.007, 3)
        estimate = gtsam.Pose3(here.rotation(), here.translation() + walk(t) + error)
        contradiction = monitor.observe(TrackPose(round(t * 1e9), "lidar", track), estimate, KNOWN)
        if contradiction is not None:
            found.append((t, contradiction))
    return found


@pytest.mark.parametrize("drift", [0.3, 1.0])
def test_an_honest_odometry_and_honest_fixes_are_never_accused(drift):
    for seed in range(6):
        assert not watch(300.0, rng=np.random.default_rng(seed), drift=drift)


def test_an_odometry_that_turns_well_at_speed_is_not_taken_for_better_where_it_is_slow():
    """A train for minutes at 35 m/s, where the attitude of an odometry says all of its residual, then it stops."""

    def way_m(t):
        braking_s = min(max(0.0, t - 200.0), 35.0)
        return 35.0 * min(t, 200.0) + 35.0 * braking_s - 0.5 * braking_s**2

    def at(t):
        return gtsam.Pose3(gtsam.Rot3(), np.array([way_m(t), 0.0, 0.0]))

    for seed in range(10):
        well_turning = np.repeat([0.3, 0.8], 3)
        assert not watch(240.0, rng=np.random.default_rng(seed), drift=well_turning, at=at)


def test_an_odometry_three_times_worse_than_configured_is_learnt_and_not_taken_for_walking_fixes():
    accused = sum(bool(watch(300.0, rng=np.random.default_rng(seed), drift=3.0)) for seed in range(6))
    assert accused <= 1


@pytest.mark.parametrize(("speed_m_s", "walk_m_s"), [(0.0, 0.08), (SPEED_M_S, 0.2)])
def test_fixes_that_walk_are_found_within_five_seconds(speed_m_s, walk_m_s):
    """While driving the odometry may drift as well: there slow walks take longer to see."""

    def walk(t):
        return np.array([walk_m_s * max(0.0, t - 60.0), 0.0, 0.0])

    for seed in range(10):
        at = partial(pose_at, speed_m_s=speed_m_s)
        found = watch(90.0, walk, np.random.default_rng(seed), drift=0.2, at=at)  # 1 cm per root metre
        assert found and 60.0 < found[0][0] < 65.5
        assert not found[0][1].is_slip


def test_the_correction_leads_back_to_where_the_odometry_sees_the_machine():
    def walk(t):
        return np.array([0.0, 0.1 * max(0.0, t - 30.0), 0.0])

    t, found = watch(60.0, walk)[0]
    back = found.T_W_I  # the odometry did not drift
    # against where it was when the two still agreed
    agreed_s = found.since_ns * 1e-9
    np.testing.assert_allclose(back.translation(), pose_at(t).translation() + walk(agreed_s), atol=1e-6)
    assert found.distance_m == pytest.approx(np.linalg.norm(walk(t) - walk(agreed_s)), rel=1e-6)


def test_an_odometry_that_loses_its_hold_is_not_taken_for_walking_fixes():
    found = watch(60.0, slip_from_s=30.0)
    assert found and found[0][1].is_slip


def test_a_walk_does_not_teach_that_the_odometry_is_bad():
    def walk(t):
        return np.array([0.05 * max(0.0, t - 60.0), 0.0, 0.0])

    for seed in range(10):
        found = watch(90.0, walk, np.random.default_rng(seed), drift=0.2)
        assert found and found[0][1].distance_m < 0.6  # 5 sigma of the drift after some ten metres


def test_in_the_first_half_minute_it_has_learnt_nothing_and_reports_nothing():
    assert not watch(30.0, lambda t: np.array([0.2 * t, 0.0, 0.0]))


def test_an_odometry_is_observed_once_a_second():
    monitor, _ = new_monitor()
    first = TrackPose(0, "lidar", gtsam.Pose3())
    assert monitor.is_due(first)
    monitor.observe(first, gtsam.Pose3(), KNOWN)
    assert not monitor.is_due(TrackPose(999_999_999, "lidar", gtsam.Pose3()))
    assert monitor.is_due(TrackPose(1_000_000_000, "lidar", gtsam.Pose3()))


def test_an_odometry_vouches_for_the_estimate_once_it_is_known_and_while_it_is_fresh():
    now_ns, before_ns = 99_000_000_000, 89_000_000_000
    vouched = 0
    for seed in range(10):
        monitor, _ = new_monitor()
        watch(25.0, rng=np.random.default_rng(seed), monitor=monitor)
        assert not monitor.vouches(10_000_000_000, 24_000_000_000)  # it accuses nobody yet, either
        monitor, _ = new_monitor()
        watch(100.0, rng=np.random.default_rng(seed), monitor=monitor)
        vouched += monitor.vouches(before_ns, now_ns)
        assert not monitor.vouches(now_ns - 60_000_000_000, now_ns)  # so long ago it has no observation
        assert not monitor.vouches(before_ns, now_ns + FRESH_NS + 1)
        monitor.forget_after(0)
        assert not monitor.vouches(before_ns, now_ns)
    assert vouched >= 5  # the largest of twenty ratios is seldom beyond 2.5


def test_after_a_jump_of_the_estimate_it_does_not_compare_with_what_was_before():
    monitor, _ = new_monitor()
    watch(100.0, rng=np.random.default_rng(1), monitor=monitor)
    monitor.forget_frame()
    moved = pose_at(100.0) * gtsam.Pose3(gtsam.Rot3(), np.array([5.0, 0.0, 0.0]))
    assert monitor.observe(TrackPose(100_000_000_000, "lidar", pose_at(100.0)), moved, KNOWN) is None
    assert monitor.observe(TrackPose(101_000_000_000, "lidar", pose_at(100.0)), pose_at(100.0), KNOWN) is not None
