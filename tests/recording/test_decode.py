"""Decoders: what ROS means becomes what Holdfast means."""

from math import atan2, cos, inf, nan, pi, sin

import numpy as np
import pytest
from bags import (
    HUMBLE,
    NOETIC,
    START_NS,
    fix,
    imu,
    joints,
    odometry,
    point,
    pose,
    pose_with_covariance,
    quaternion,
    stamped,
    twist,
    twist_with_covariance,
)
from hypothesis import given
from hypothesis import strategies as st

from holdfast.config.sensors import ImuConfig
from holdfast.errors import ConfigError, RecordingError
from holdfast.messages import FixStatus
from holdfast.recording.decode import UndecodableError
from holdfast.recording.kinds import KINDS, make_decoder
from holdfast.recording.source import Subscription

STORES = (NOETIC, HUMBLE)
ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)


def decode(kind, message, joint_name=None, store=HUMBLE, arrival_ns=7):
    """Send a message through its bytes and the decoder."""
    name = message.__msgtype__
    if store is NOETIC:
        message = store.deserialize_ros1(store.serialize_ros1(message, name), name)
    else:
        message = store.deserialize_cdr(store.serialize_cdr(message, name), name)
    return make_decoder(Subscription("/t", "sensor", kind, joint_name), name, "file")(message, arrival_ns)


@pytest.mark.parametrize("store", STORES)
@given(rate=st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT), force=st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT))
def test_imu_passes_every_float_on_unchanged(store, rate, force) -> None:
    sample = decode("imu", imu(store, START_NS + 123, rate, force), store=store)
    np.testing.assert_array_equal(sample.angular_velocity, rate)
    np.testing.assert_array_equal(sample.specific_force, force)
    assert (sample.stamp_ns, sample.arrival_ns, sample.sensor) == (START_NS + 123, 7, "sensor")


@pytest.mark.parametrize("store", STORES)
def test_readings_of_a_driver_with_other_units_are_multiplied(store) -> None:
    section = ImuConfig(kind="imu", topic="/imu", gyroscope_factors=(0.1, 1.0, -1.0), accelerometer_factors=(9.8,) * 3)
    message = imu(store, START_NS, (1.0, 2.0, 3.0), (0.0, 0.5, 1.0))
    subscription = Subscription("/t", "sensor", "imu", factors=section.factors)
    sample = make_decoder(subscription, message.__msgtype__, "file")(message, 7)
    np.testing.assert_allclose(sample.angular_velocity, (0.1, 2.0, -3.0))
    np.testing.assert_allclose(sample.specific_force, (0.0, 4.9, 9.8))
    assert (sample.stamp_ns, sample.arrival_ns, sample.sensor) == (START_NS, 7, "sensor")


def test_a_factor_of_zero_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"gyroscope_factors: must not hold 0"):
        ImuConfig(kind="imu", topic="/imu", gyroscope_factors=(1.0, 0.0, 1.0))


@given(stamp_ns=st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_are_exact(stamp_ns) -> None:
    assert decode("imu", imu(HUMBLE, stamp_ns)).stamp_ns == stamp_ns


@given(status=st.integers(-128, 127))
def test_every_status_is_mapped_and_what_is_unknown_is_unknown(status) -> None:
    expected = FixStatus(status) if -2 <= status <= 2 else FixStatus.UNKNOWN
    assert decode("gnss", fix(HUMBLE, START_NS, status=status)).status is expected


@given(position=st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT), cov=st.lists(ANY_FLOAT, min_size=9, max_size=9))
def test_gnss_never_fails_and_its_covariance_is_finite_or_none(position, cov) -> None:
    message = decode("gnss", fix(HUMBLE, START_NS, position=position, cov=cov))
    np.testing.assert_array_equal((message.latitude_deg, message.longitude_deg, message.altitude_m), position)
    known = np.isfinite(cov).all() and np.any(cov[::4]) and min(cov[::4]) >= 0
    assert (message.covariance is not None) == known
    if known:
        np.testing.assert_array_equal(message.covariance.ravel(), cov)


@pytest.mark.parametrize(
    ("cov", "cov_type"),
    [(np.eye(3).ravel(), 0), (np.zeros(9), 2), ([nan] * 9, 3), ([-1.0] + [0.0] * 8, 2)],
    ids=["type unknown", "zeros", "nan", "REP-145"],
)
def test_gnss_covariance_that_means_nothing_is_none(cov, cov_type) -> None:
    assert decode("gnss", fix(HUMBLE, START_NS, cov=cov, cov_type=cov_type)).covariance is None


def test_gnss_covariance_is_a_writable_matrix_of_its_own() -> None:
    covariance = decode("gnss", fix(HUMBLE, START_NS)).covariance
    assert covariance.diagonal().tolist() == [0.01, 0.02, 0.03]
    covariance[0, 0] = 1.0


def asymmetric():
    ros = np.arange(36.0).reshape(6, 6) + 1
    return ros + ros.T


def assert_rotation_first(gtsam, ros):
    np.testing.assert_array_equal(gtsam[:3, :3], ros[3:, 3:])
    np.testing.assert_array_equal(gtsam[3:, 3:], ros[:3, :3])
    np.testing.assert_array_equal(gtsam[:3, 3:], ros[3:, :3])
    np.testing.assert_array_equal(gtsam[3:, :3], ros[:3, 3:])


@pytest.mark.parametrize("store", STORES)
@pytest.mark.parametrize("kind", ["odometry", "pose"])
def test_the_covariance_of_a_pose_is_permuted_to_rotation_first(kind, store) -> None:
    message = odometry(store, START_NS, cov=asymmetric().ravel())
    assert_rotation_first(decode(kind, message, store=store).covariance, asymmetric())


@pytest.mark.parametrize("store", STORES)
def test_twists_of_all_three_types_decode_alike_and_their_covariance_is_angular_first(store) -> None:
    motion = {"linear": (1.0, 2.0, 3.0), "angular": (0.1, 0.2, 0.3)}
    known = twist_with_covariance(store, asymmetric().ravel(), **motion)
    plain = decode("twist", stamped(store, START_NS, "TwistStamped", twist(store, **motion)), store=store)
    with_covariance = decode("twist", stamped(store, START_NS, "TwistWithCovarianceStamped", known), store=store)
    of_odometry = decode("twist", odometry(store, START_NS, moving=known), store=store)
    for decoded in (plain, with_covariance, of_odometry):
        assert decoded.linear.tolist() == [1.0, 2.0, 3.0]
        assert decoded.angular.tolist() == [0.1, 0.2, 0.3]
        assert (decoded.stamp_ns, decoded.arrival_ns, decoded.sensor) == (START_NS, 7, "sensor")
    assert plain.covariance is None
    assert_rotation_first(with_covariance.covariance, asymmetric())
    assert_rotation_first(of_odometry.covariance, asymmetric())


def test_a_twist_that_is_not_finite_is_passed_on_to_be_counted() -> None:
    message = stamped(HUMBLE, START_NS, "TwistStamped", twist(HUMBLE, linear=(nan, 0.0, inf)))
    np.testing.assert_array_equal(decode("twist", message).linear, [nan, 0.0, inf])


@pytest.mark.parametrize("store", STORES)
def test_a_velocity_of_gnss_is_decoded_of_both_twists_with_its_linear_covariance_only(store) -> None:
    """ublox and septentrio write -1 into the angular variances; septentrio NaN and -1 for what was not measured."""
    motion = {"linear": (1.0, 2.0, nan)}
    ros = asymmetric()
    ros[3:, 3:], ros[2, 2] = -1.0, nan
    plain = decode("gnss_velocity", stamped(store, START_NS, "TwistStamped", twist(store, **motion)), store=store)
    content = twist_with_covariance(store, ros.ravel(), **motion)
    known = decode("gnss_velocity", stamped(store, START_NS, "TwistWithCovarianceStamped", content), store=store)
    content = twist_with_covariance(store, np.zeros(36), **motion)
    unknown = decode("gnss_velocity", stamped(store, START_NS, "TwistWithCovarianceStamped", content), store=store)
    for decoded in (plain, known, unknown):
        np.testing.assert_array_equal(decoded.velocity, [1.0, 2.0, nan])
        assert (decoded.stamp_ns, decoded.arrival_ns, decoded.sensor) == (START_NS, 7, "sensor")
    assert plain.covariance is None and unknown.covariance is None
    np.testing.assert_array_equal(known.covariance, ros[:3, :3])


def test_a_prism_is_a_point_or_the_position_of_a_pose_whose_rotation_does_not_matter() -> None:
    plain = decode("prism", point(HUMBLE, (4.0, 5.0, 6.0)))
    assert (plain.position.tolist(), plain.covariance) == ([4.0, 5.0, 6.0], None)
    ros = asymmetric()
    ros[3:, 3:] = -1.0  # a station has no rotation and may mark it so
    content = pose_with_covariance(HUMBLE, ros.ravel(), xyzw=(0.0, 0.0, 0.0, 0.0))
    known = decode("prism", stamped(HUMBLE, START_NS, "PoseWithCovarianceStamped", content))
    assert known.position.tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(known.covariance, ros[:3, :3])


def test_a_height_is_the_z_of_three_types() -> None:
    covariance = np.zeros((6, 6))
    covariance[2, 2] = 0.04
    content = pose_with_covariance(HUMBLE, covariance.ravel())
    messages = (
        point(HUMBLE, (1.0, 2.0, 3.0)),
        stamped(HUMBLE, START_NS, "PoseStamped", pose(HUMBLE)),
        stamped(HUMBLE, START_NS, "PoseWithCovarianceStamped", content),
    )
    decoded = [decode("height", message) for message in messages]
    assert [(one.height_m, one.sigma_m) for one in decoded] == [(3.0, None), (3.0, None), (3.0, pytest.approx(0.2))]


@pytest.mark.parametrize("cov", [np.zeros(36), [-1.0, *[0.0] * 35], [nan] * 36], ids=["zeros", "minus one", "nan"])
def test_a_covariance_that_means_nothing_is_unknown_for_every_kind(cov) -> None:
    assert decode("pose", odometry(HUMBLE, START_NS, cov=cov)).covariance is None
    assert decode("twist", odometry(HUMBLE, START_NS, moving=twist_with_covariance(HUMBLE, cov))).covariance is None
    message = stamped(HUMBLE, START_NS, "PoseWithCovarianceStamped", pose_with_covariance(HUMBLE, cov))
    assert decode("prism", message).covariance is None
    assert decode("height", message).sigma_m is None


def test_poses_of_all_three_types_decode_alike() -> None:
    half = 0.5**0.5
    xyzw = (0.0, 0.0, half, half)
    with_covariance = pose_with_covariance(HUMBLE, xyzw=xyzw)
    for message in (
        stamped(HUMBLE, START_NS, "PoseStamped", pose(HUMBLE, xyzw=xyzw)),
        stamped(HUMBLE, START_NS, "PoseWithCovarianceStamped", with_covariance),
        odometry(HUMBLE, START_NS, xyzw=xyzw),
    ):
        decoded = decode("odometry", message)
        assert decoded.position.tolist() == [1.0, 2.0, 3.0]
        np.testing.assert_allclose(decoded.quaternion, [0, 0, half, half], atol=1e-15)
        assert decoded.covariance is None


@given(xyzw=st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT, ANY_FLOAT), position=st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT))
def test_a_lidar_pose_has_unit_norm_and_is_finite_or_it_is_refused(xyzw, position) -> None:
    try:
        decoded = decode("odometry", odometry(HUMBLE, START_NS, xyzw=xyzw, position=position))
    except UndecodableError:
        return
    assert abs(np.linalg.norm(decoded.quaternion) - 1) < 1e-12
    assert np.isfinite(decoded.position).all()


@given(scale=st.floats(0.9901, 1.0099), yaw=st.floats(-pi, pi))
def test_a_quaternion_rounded_by_its_sender_is_normalised(scale, yaw) -> None:
    xyzw = (0.0, 0.0, scale * sin(yaw / 2), scale * cos(yaw / 2))
    quaternion = decode("odometry", odometry(HUMBLE, START_NS, xyzw=xyzw)).quaternion
    np.testing.assert_allclose(quaternion, (0, 0, sin(yaw / 2), cos(yaw / 2)), atol=1e-12)


@pytest.mark.parametrize("xyzw", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.02), (nan, 0.0, 0.0, 1.0), (inf, 0, 0, 0)])
def test_a_quaternion_far_from_unit_norm_is_refused(xyzw) -> None:
    with pytest.raises(UndecodableError, match="norm"):
        decode("odometry", odometry(HUMBLE, START_NS, xyzw=xyzw))


@given(yaw=st.floats(-3.1, 3.1), pitch=st.floats(-1.5, 1.5), roll=st.floats(-3.1, 3.1))
def test_heading_is_the_yaw_of_the_x_axis_whatever_roll_and_pitch(yaw, pitch, roll) -> None:
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll / 2, pitch / 2, yaw / 2]), np.sin([roll / 2, pitch / 2, yaw / 2])
    xyzw = (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
    alone = stamped(HUMBLE, START_NS, "QuaternionStamped", quaternion(HUMBLE, xyzw))
    for message in (alone, imu(HUMBLE, START_NS, xyzw=xyzw)):
        error = decode("heading", message).yaw_rad - yaw
        assert abs(atan2(sin(error), cos(error))) < 1e-9


def test_heading_sigma_comes_from_the_yaw_variance_and_zero_is_unknown() -> None:
    known = imu(HUMBLE, START_NS, orientation_cov=[1, 0, 0, 0, 1, 0, 0, 0, 0.0004])
    assert decode("heading", known).sigma_rad == pytest.approx(0.02)
    for variance in (0.0, nan, inf, -1.0):
        unknown = imu(HUMBLE, START_NS, orientation_cov=[0, 0, 0, 0, 0, 0, 0, 0, variance])
        assert decode("heading", unknown).sigma_rad is None


def test_an_imu_that_reports_no_orientation_gives_no_heading() -> None:
    with pytest.raises(UndecodableError, match="no orientation"):
        decode("heading", imu(HUMBLE, START_NS, orientation_cov=[-1] + [0] * 8))


def test_a_vertical_x_axis_has_no_heading() -> None:
    half = 0.5**0.5
    with pytest.raises(UndecodableError, match="vertical"):
        decode("heading", imu(HUMBLE, START_NS, xyzw=(0.0, half, 0.0, half)))


@pytest.mark.parametrize("store", STORES)
def test_the_named_joint_is_taken(store) -> None:
    message = joints(store, START_NS, ("boom", "turn", "bucket"), (1.0, 2.0, 3.0))
    assert decode("joint", message, "turn", store).angle_rad == 2.0


def test_a_single_joint_needs_no_name() -> None:
    assert decode("joint", joints(HUMBLE, START_NS)).angle_rad == 0.5
    assert decode("joint", joints(HUMBLE, START_NS, (), (0.25,))).angle_rad == 0.25


def test_several_joints_need_a_name_and_the_error_lists_them() -> None:
    with pytest.raises(RecordingError, match="/t: set joint_name to one of boom, turn"):
        decode("joint", joints(HUMBLE, START_NS, ("boom", "turn"), (1.0, 2.0)))


@pytest.mark.parametrize(("names", "positions"), [(("boom",), (1.0,)), (("turn",), ()), (("turn",), (nan,)), ((), ())])
def test_a_message_without_the_joint_is_refused(names, positions) -> None:
    with pytest.raises(UndecodableError):
        decode("joint", joints(HUMBLE, START_NS, names, positions), "turn")


def test_every_kind_refuses_types_of_other_kinds() -> None:
    types = {name for kind in KINDS.values() for name in kind.types} | {"std_msgs/msg/String"}
    for kind in KINDS.values():
        for name in types - set(kind.types):
            with pytest.raises(RecordingError, match=f"file: topic '/t' is {name}, which is no {kind.name} "):
                make_decoder(Subscription("/t", "s", kind.name), name, "file")
