"""What faults do to sensors other than GNSS."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from struck import DURATION_S, HEALTHY, same, strike, within

from holdfast.errors import ConfigError


@pytest.mark.parametrize("name", ["imu", "base_imu"])
def test_a_logger_draws_lines_between_the_samples_at_both_ends(name):
    before, after = HEALTHY[name], strike("line", 10.05, 20.05, sensors=(name,))[name]
    first, last = 100, 201
    fraction = (before.times_s[first : last + 1] - before.times_s[first]) / 10.1
    for column in ("angular_velocity", "specific_force"):
        ends = before.values[column][first], before.values[column][last]
        expected = ends[0] + np.outer(fraction, ends[1] - ends[0])
        np.testing.assert_allclose(after.values[column][first : last + 1], expected, atol=1e-12)
    assert after.times_s is before.times_s
    assert after.values["gyroscope_bias"] is before.values["gyroscope_bias"]


def test_a_line_to_the_end_of_the_recording_is_level():
    after = strike("line", 30.0, 50.0)["imu"].values["specific_force"]
    np.testing.assert_array_equal(after[300:], np.tile(after[299], (100, 1)))


def test_a_line_over_the_whole_recording_is_refused():
    with pytest.raises(ConfigError, match="line at 0 s leaves no sample of imu"):
        strike("line", 0.0, DURATION_S)


def relative(lidar, first, last):
    position, attitude = lidar.values["position"], Rotation.from_quat(lidar.values["quaternion"])
    return attitude[first].inv().apply(position[last] - position[first]), attitude[first].inv() * attitude[last]


def test_the_lidar_jumps_in_its_own_frame():
    before, after = HEALTHY["lidar"], strike("jump", 10.0, 10.0, offset_m=(1.0, 0.5, -0.2), yaw_deg=30.0)["lidar"]
    expected_p, expected_R = relative(before, 99, 100)
    p, R = relative(after, 99, 100)
    np.testing.assert_allclose(p, expected_p + expected_R.apply([1.0, 0.5, -0.2]), atol=1e-12)
    np.testing.assert_allclose((expected_R.inv() * R).as_rotvec(degrees=True), [0.0, 0.0, 30.0], atol=1e-9)


@pytest.mark.parametrize(("first", "last"), [(100, 101), (100, 399), (250, 390), (0, 99)])
def test_all_other_relative_motion_of_the_lidar_is_right(first, last):
    before, after = HEALTHY["lidar"], strike("jump", offset_m=(1.0, 0.5, -0.2), yaw_deg=30.0)["lidar"]
    (expected_p, expected_R), (p, R) = relative(before, first, last), relative(after, first, last)
    np.testing.assert_allclose(p, expected_p, atol=1e-12)
    assert (expected_R.inv() * R).magnitude() < 1e-12
    assert after.values["covariance"] is before.values["covariance"]


def test_a_jump_after_the_last_pose_is_none():
    assert same(strike("jump", 50.0, 50.0)["lidar"], HEALTHY["lidar"])


def test_a_frozen_encoder_repeats_its_first_angle():
    after = strike("freeze")["joint"]
    np.testing.assert_array_equal(after.values["angle_rad"][within(after)], np.sin(10.0))
    np.testing.assert_array_equal(after.values["angle_rad"][~within(after)], np.sin(after.times_s[~within(after)]))


def test_a_frozen_twist_repeats_its_first_velocity():
    before, after = HEALTHY["wheels"], strike("freeze", sensors=("wheels",))["wheels"]
    for column in ("linear", "angular"):
        assert (after.values[column][within(after)] == before.values[column][100]).all()
        np.testing.assert_array_equal(after.values[column][~within(after)], before.values[column][~within(before)])


def test_a_receiver_that_is_stuck_repeats_its_first_velocity_with_its_claim():
    before, after = HEALTHY["doppler"], strike("freeze", sensors=("doppler",))["doppler"]
    inside = within(before)
    np.testing.assert_array_equal(
        after.values["velocity"][inside], before.values["velocity"][inside][:1].repeat(101, 0)
    )
    assert same(after.taken(~inside), before.taken(~inside))
    assert after.values["sigma"] is before.values["sigma"]


def test_spinning_wheels_report_a_fraction_and_a_constant_too_much_along_x():
    before, after = HEALTHY["wheels"], strike("slip", sensors=("wheels",), slip_ratio=0.3, slip_m_s=0.5)["wheels"]
    inside = within(before)
    expected = 1.3 * before.values["linear"][inside, 0] + 0.5
    np.testing.assert_allclose(after.values["linear"][inside, 0], expected)
    np.testing.assert_array_equal(after.values["linear"][:, 1:], before.values["linear"][:, 1:])
    assert after.values["angular"] is before.values["angular"]


@pytest.mark.parametrize("kind", ["swap", "offset"])
def test_a_station_that_follows_another_prism_is_off_by_a_constant_and_claims_to_be_good(kind):
    before, after = HEALTHY["prism"], strike(kind, sensors=("prism",), offset_m=(2.0, -1.0, 0.3))["prism"]
    moved = after.values["position"] - before.values["position"]
    np.testing.assert_allclose(moved, within(before)[:, None] * np.array([2.0, -1.0, 0.3]), atol=1e-12)
    assert after.values["sigma"] is before.values["sigma"]
    np.testing.assert_array_equal(after.values["faulty"], within(before))


def test_poses_that_are_off_are_moved_in_their_frame_and_keep_their_attitude():
    before, after = HEALTHY["markers"], strike("offset", sensors=("markers",), offset_m=(1.0, 0.0, 0.0))["markers"]
    moved = after.values["position"] - before.values["position"]
    np.testing.assert_allclose(moved, within(before)[:, None] * np.array([1.0, 0.0, 0.0]), atol=1e-12)
    assert after.values["quaternion"] is before.values["quaternion"]


def test_the_frame_of_the_poses_jumps_for_good():
    before, after = HEALTHY["markers"], strike("jump", sensors=("markers",), offset_m=(1.0, 0.5, 0.0))["markers"]
    expected_p, expected_R = relative(before, 99, 100)
    expected_p = expected_p + expected_R.apply([1.0, 0.5, 0.0])
    np.testing.assert_allclose(relative(after, 99, 100)[0], expected_p, atol=1e-12)
    np.testing.assert_allclose(relative(after, 150, 390)[0], relative(before, 150, 390)[0], atol=1e-12)


def test_a_frozen_odometry_repeats_its_first_pose():
    before, after = HEALTHY["lidar"], strike("freeze", sensors=("lidar",))["lidar"]
    inside = within(before)
    for column in ("position", "quaternion"):
        first = before.values[column][inside][:1]
        np.testing.assert_array_equal(after.values[column][inside], first.repeat(inside.sum(), 0))
    assert same(after.taken(~inside), before.taken(~inside))
