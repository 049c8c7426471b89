"""Where a sensor sits and how its frame moves, also beyond the turn joint, against differences of poses."""

import gtsam
import numpy as np
import pytest
from motion import at, machine
from slewing import DRIVING, T_B_BI, T_B_P, T_C_I
from slewing import machine as slewing_machine

from holdfast.sensors.mount import Mount
from holdfast.sensors.sensor import Joint, State

T_I_S = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.5, -0.1, 1.3), np.array([1.0, -0.5, 0.2]))
TIMES_S = [0.0, 1.3, 4.0, 7.7]


def state_at(t):
    estimate = DRIVING.estimate(t)
    joint = Joint(DRIVING.angle(t), DRIVING.angle_rate(t))
    return State(estimate.nav, np.zeros((9, 9)), estimate.angular_velocity, joint)


def velocity_of(pose, t, h=1e-5):
    """In its own axes, by differences of its poses in W."""
    v_W = (pose(t + h).translation() - pose(t - h).translation()) / (2.0 * h)
    return pose(t).rotation().unrotate(v_W)


def test_a_fixed_frame_sits_where_the_extrinsics_put_it_whatever_the_joint_does():
    mount = Mount(machine(more={"wheels": {"kind": "twist", "mount": T_I_S}}), "wheels")
    assert not mount.is_beyond_joint
    assert mount.T_I_S(Joint(1.0, 2.0)).equals(T_I_S, 1e-12)


@pytest.mark.parametrize("t", TIMES_S)
@pytest.mark.parametrize(("frame", "T_B_S"), [("base_link", gtsam.Pose3()), ("base_imu", T_B_BI), ("ring", T_B_P)])
def test_a_frame_on_the_chassis_stays_there_however_the_cabin_turns(frame, T_B_S, t):
    mount = Mount(slewing_machine(), frame)
    assert mount.is_beyond_joint
    found = DRIVING.T_W_I(t) * mount.T_I_S(state_at(t).joint)
    assert found.equals(DRIVING.T_W_B(t) * T_B_S, 1e-9)


@pytest.mark.parametrize("t", TIMES_S)
@pytest.mark.parametrize(("frame", "T_B_S"), [("base_link", gtsam.Pose3()), ("base_imu", T_B_BI)])
def test_the_velocity_on_the_chassis_is_that_of_the_chassis_rates_included(frame, T_B_S, t):
    velocity, _ = Mount(slewing_machine(), frame).velocity(state_at(t))
    np.testing.assert_allclose(velocity, velocity_of(lambda t: DRIVING.T_W_B(t) * T_B_S, t), atol=1e-7)


@pytest.mark.parametrize("t", TIMES_S)
def test_the_velocity_in_the_cabin_is_that_of_the_cabin(t):
    velocity, _ = Mount(slewing_machine(), "cabin").velocity(state_at(t))
    np.testing.assert_allclose(velocity, velocity_of(lambda t: DRIVING.T_W_I(t) * T_C_I.inverse(), t), atol=1e-7)


def test_a_rate_of_the_joint_moves_what_is_off_its_axis():
    """Without it a cabin that turns on a standing chassis would be taken for a chassis that turns."""
    mount, here = Mount(slewing_machine(), "base_imu"), state_at(1.0)
    still, _ = mount.velocity(here._replace(joint=Joint(here.joint.angle_rad, 0.0)))
    assert np.linalg.norm(still - mount.velocity(here)[0]) > 0.1


def test_velocity_depends_on_attitude_and_velocity_of_the_imu_as_claimed():
    mount, here, h = Mount(slewing_machine(), "base_imu"), state_at(2.0), 1e-6
    _, H = mount.velocity(here)
    for index, step in enumerate(np.eye(9) * h):
        after, before = (mount.velocity(here._replace(nav=here.nav.retract(by)))[0] for by in (step, -step))
        np.testing.assert_allclose(H[:, index], (after - before) / (2.0 * h), atol=1e-8)


def test_without_a_turn_joint_no_frame_is_beyond_it():
    assert not Mount(machine(more={"wheels": {"kind": "twist", "mount": at([1.0, 0.0, 0.0])}}), "imu").is_beyond_joint


@pytest.mark.parametrize(
    "mount",
    [
        Mount(machine(more={"wheels": {"kind": "twist", "mount": T_I_S}}), "wheels"),
        Mount(slewing_machine(), "base_link"),
        Mount(slewing_machine(), "base_imu"),
    ],
    ids=["fixed", "base", "on the chassis"],
)
def test_many_angles_at_once_are_one_after_the_other(mount):
    angles = np.array([0.0, 0.3, -2.0, 7.0])
    expected = [mount.T_I_S(Joint(angle, 0.0)).inverse() for angle in angles]
    R, p = mount.T_S_I(angles)
    np.testing.assert_allclose(R, [pose.rotation().matrix() for pose in expected], rtol=0, atol=1e-14)
    np.testing.assert_allclose(p, [pose.translation() for pose in expected], rtol=0, atol=1e-14)
