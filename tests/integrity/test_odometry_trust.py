"""The trust in one odometry: what is a lie, and when it is over."""

import gtsam
import numpy as np
import pytest
from motion import ns

from holdfast.config.sensors import OdometryConfig
from holdfast.integrity.odometry_trust import OdometryTrust, Watched
from holdfast.sensors.odometry import TrackPose
from holdfast.sensors.odometry_calibration import OdometryCalibration

ASIDE = np.array([0.0, 0.0, 0.0, 12.0, 3.0, 0.0])  # sigmas
STILL = np.zeros(7)


def begun():
    return OdometryTrust(OdometryCalibration(OdometryConfig(kind="odometry", topic="/lidar"), gtsam.Pose3()))


def lost():
    trust = begun()
    trust.lose()
    return trust


def noted(trust, jumps):
    since_ns = []
    for k, jump in enumerate(jumps):
        trust.note_motion(ns(0.1 * k), jump)
        since_ns.append(trust.lies_since_ns)
    return since_ns


def test_motions_that_depart_one_after_another_in_one_direction_are_a_lie_since_the_first():
    assert noted(begun(), [None, ASIDE, 1.2 * ASIDE, ASIDE, 0.8 * ASIDE]) == [None, None, None, None, ns(0.1)]


def test_motions_that_take_each_other_back_are_outliers_or_noise():
    assert not any(noted(begun(), [ASIDE, -ASIDE] * 20))
    rng = np.random.default_rng(1)
    poses = 20.0 * rng.standard_normal((400, 6))
    assert not any(noted(begun(), np.diff(poses, axis=0)))  # each pose is wrong, none goes away


def test_a_motion_that_the_imu_measured_ends_a_run():
    assert not any(noted(begun(), [ASIDE, ASIDE, ASIDE, None] * 5))


@pytest.mark.parametrize(
    ("second_s", "distance_m", "moved_m", "lies"),
    [
        (3.0, 4.0, 10.0, True),
        (6.0, 4.0, 10.0, False),  # long after the first
        (3.0, 2.0, 10.0, False),  # a scale that is wrong by a fifth is worth more than none
    ],
)
def test_what_slips_again_soon_and_by_much_of_its_way_lies(second_s, distance_m, moved_m, lies):
    trust = begun()
    assert not trust.note_slip(ns(0.0), distance_m, moved_m)
    assert trust.note_slip(ns(second_s), distance_m, moved_m) is lies


def driven(trust, odometry, estimate, until_s, of_velocity_m_s=0.05, *, is_led=False):
    """Watch every second; return when it is trusted again, or None. Both are x [m], or poses, by time."""

    def pose(where):
        return where if isinstance(where, gtsam.Pose3) else gtsam.Pose3(gtsam.Rot3(), np.array([where, 0.0, 0.0]))

    covariance = np.diag(np.repeat([1e-3, 0.05, of_velocity_m_s], 3) ** 2)
    for t in np.arange(0.0, until_s, 1.0):
        measured = TrackPose(ns(t), "lidar", pose(odometry(t)))
        assert trust.is_due(measured)
        watched = trust.watched
        seen = None if watched is None else Watched(watched, pose(estimate(t - 1.0)), covariance)
        if trust.watch(measured, seen, STILL, is_led=is_led):
            return t
    return None


def test_it_is_trusted_again_when_it_has_moved_as_the_estimate_for_five_seconds():
    trust = lost()
    assert driven(trust, lambda t: 7.0 + 5.0 * t, lambda t: 5.0 * t, 20.0) == 6.0  # the sixth is compared then
    assert not trust.is_lost


def test_one_that_stands_while_the_estimate_moves_is_not():
    trust = lost()
    assert driven(trust, lambda _: 0.0, lambda t: 0.5 * t, 60.0) is None
    assert trust.is_lost


def test_it_is_not_trusted_before_the_lie_is_over_for_so_long():
    assert driven(lost(), lambda t: 5.0 * max(t, 10.0), lambda t: 5.0 * t, 30.0) == 16.0


def test_one_that_turns_otherwise_is_not_trusted():
    def turning(t):
        return gtsam.Pose3(gtsam.Rot3.Yaw(0.2 * t), np.zeros(3))

    assert driven(lost(), turning, lambda _: gtsam.Pose3(), 30.0) is None
    assert driven(lost(), turning, turning, 30.0) == 6.0


def test_without_fixes_an_estimate_that_knows_little_has_little_to_say_against_it():
    assert driven(lost(), lambda t: 6.0 * t, lambda t: 5.0 * t, 30.0) is None
    assert driven(lost(), lambda t: 6.0 * t, lambda t: 5.0 * t, 30.0, of_velocity_m_s=0.5) == 6.0


def test_at_standstill_nothing_tells_whether_it_is_right():
    assert driven(lost(), lambda _: 0.0, lambda _: 0.0, 90.0) is None
    assert driven(lost(), lambda t: max(0.0, t - 20.0), lambda t: max(0.0, t - 20.0), 90.0) == 22.0  # a metre on


def test_one_that_is_mounted_otherwise_does_not_pass_by_moving_little():
    def otherwise(t):
        return gtsam.Pose3(gtsam.Rot3(), 0.3 * t * np.array([np.cos(1.15), np.sin(1.15), 0.0]))

    assert driven(lost(), otherwise, lambda t: 0.3 * t, 60.0) is None


def test_with_fixes_it_waits_until_the_estimate_knows_more():
    said = (lambda t: 6.0 * t), (lambda t: 5.0 * t), 30.0
    assert driven(lost(), *said, of_velocity_m_s=2.0, is_led=True) is None
    assert driven(lost(), *said, of_velocity_m_s=2.0) == 6.0


def round_bends(t):
    return gtsam.Pose3(gtsam.Rot3.Yaw(0.2 * t), np.array([10.0 * np.sin(0.2 * t), 10.0 - 10.0 * np.cos(0.2 * t), 0.0]))


def seen_by(turned, where):
    C = gtsam.Pose3(turned, np.zeros(3))
    return lambda t: C * where(t) * C.inverse()


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.5, -0.7, 0.6)])
@pytest.mark.parametrize("by_rad", [0.3, 2.9])
def test_it_is_found_mounted_otherwise_than_configured(axis, by_rad):
    trust, delta = lost(), by_rad * np.array(axis) / np.linalg.norm(axis)
    # T_I0_I as configured is that of a sensor turned by delta, seen from I
    at_s = driven(trust, seen_by(gtsam.Rot3.Expmap(delta).inverse(), round_bends), round_bends, 40.0, is_led=True)
    assert 8.0 < at_s < 12.0
    assert trust.mount == pytest.approx(delta, abs=1e-6)


@pytest.mark.parametrize(
    "lie",
    [
        lambda _: gtsam.Pose3(),  # frozen
        lambda t: round_bends(2.0 * t),  # of another scale
        lambda t: gtsam.Pose3(gtsam.Rot3(), np.array([3.0 * t, 0.0, 0.0])) * round_bends(t),  # away
    ],
)
def test_no_mount_makes_a_lie_true(lie):
    assert driven(lost(), lie, round_bends, 60.0, is_led=True) is None
