"""An absolute pose: that of the IMU through the mounting, in W or in a frame that is offset from it."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import NOT_TURNED
from numeric import PLACED, assert_derivatives, random_state, solved

from holdfast.config.sensors import PoseConfig
from holdfast.events import Outcome
from holdfast.messages import SensorPose
from holdfast.sensors.pose import FramePose, PoseModel

T_I_S = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.5, 1.2), np.array([0.6, -0.4, 1.5]))
CONFIG = PoseConfig(kind="pose", topic="/pose")
OFFSET = {"offset_sigma_m": 5.0, "offset_sigma_deg": 10.0}
SIGMAS = [5.0, 5.0, 5.0, np.radians(10.0)]


def model(**settings):
    return PoseModel("marker", CONFIG.model_copy(update=settings), T_I_S)


def message(T_F_S, covariance=None):
    q = T_F_S.rotation().toQuaternion()
    return SensorPose(1_000, 2_000, "marker", T_F_S.translation(), np.array([q.x(), q.y(), q.z(), q.w()]), covariance)


HERE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, 0.2, -0.9), np.array([3.0, 4.0, 5.0]))


def frame(parameter):
    """The pose of F in W."""
    return gtsam.Pose3(gtsam.Rot3.Yaw(parameter[3]), parameter[:3]) if len(parameter) else gtsam.Pose3()


def true(state, error=NOT_TURNED):
    """What the sensor would measure at a state, and an error in I."""
    return FramePose(0, "marker", frame(state.parameter).inverse() * state.nav.pose() * error, np.eye(6) * 0.01**2)


def test_the_mounting_leads_from_the_sensor_to_the_imu():
    assert model().convert(message(HERE * T_I_S), PLACED).T_F_I.equals(HERE, 1e-9)


@given(st.integers(0, 10_000), st.sampled_from([(), SIGMAS]))
def test_the_innovation_is_zero_at_the_truth_and_has_the_derivatives_that_it_claims_there(seed, sigmas):
    state = random_state(seed, sigmas)
    np.testing.assert_allclose(model().innovation(true(state), state).y, 0.0, atol=1e-8)
    assert_derivatives(model(), true(state), state)


@given(st.integers(0, 10_000))
def test_the_innovation_is_the_error_of_the_pose_seen_from_the_imu(seed):
    state, error = random_state(seed), np.array([0.01, -0.02, 0.03, 0.4, -0.5, 0.6])
    off = gtsam.Pose3(gtsam.Rot3.Expmap(error[:3]), error[3:])
    np.testing.assert_allclose(model().innovation(true(state, off), state).y, error, atol=1e-9)


def test_the_factor_leads_from_far_away_to_the_measured_pose():
    state = random_state(4)._replace(covariance=np.eye(9) * 100.0)
    off = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.3), np.array([1.0, 2.0, -1.0]))
    found = solved(model(), true(state, off), state).nav.pose()
    assert found.equals(state.nav.pose() * off, 1e-3)


def test_where_the_pose_is_known_the_factor_finds_the_offset_of_the_frame():
    state = random_state(5, [0.0] * 4)._replace(covariance=np.eye(9) * 1e-10, parameter_covariance=np.diag(SIGMAS) ** 2)
    offset = np.array([2.0, -3.0, 1.0, 0.1])
    measured = true(state._replace(parameter=offset))
    # the prior of 10 deg pulls the yaw back by (0.01 rad / 10 deg)^2 of 0.1 rad, seen from 20 m
    np.testing.assert_allclose(solved(model(**OFFSET), measured, state).parameter, offset, atol=0.03)


@pytest.mark.parametrize("field", ["position", "quaternion"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_pose_that_is_not_finite_is_refused(field, value):
    broken = getattr(message(HERE), field).copy()
    broken[2] = value
    assert model().convert(replace(message(HERE), **{field: broken}), PLACED) is Outcome.NOT_FINITE


def test_a_position_beyond_any_map_is_out_of_range():
    assert model().convert(replace(message(HERE), position=np.array([0.0, -1e9, 0.0])), PLACED) is Outcome.OUT_OF_RANGE


def test_a_claim_counts_above_the_floor_only_and_is_carried_to_the_imu():
    claim = np.diag([0.001, 0.2, 0.2, 0.001, 3.0, 3.0]) ** 2
    floored = np.diag([0.01, 0.2, 0.2, 0.05, 3.0, 3.0]) ** 2
    adjoint = T_I_S.AdjointMap()
    for given_claim, expected in ((claim, floored), (None, np.diag(np.repeat([0.01, 0.05], 3) ** 2))):
        covariance = model().convert(message(HERE, given_claim), PLACED).covariance
        np.testing.assert_allclose(covariance, adjoint @ expected @ adjoint.T, atol=1e-12)


def test_a_frame_that_is_w_has_no_parameter_and_one_that_is_offset_has_four_numbers():
    assert model().parameters == ()
    np.testing.assert_allclose(model(**OFFSET).parameters[0].sigmas, SIGMAS)
    assert (model(offset_sigma_m=1.0).parameters[0].sigmas > 0.0).all()


def test_the_time_offset_is_applied():
    assert model(time_offset_s=-1e-6).convert(message(HERE), PLACED).stamp_ns == 0
