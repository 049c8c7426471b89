"""The machine moves as its frames, its ground and its driver allow, and every derivative is exact."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.sim.motion import Motion
from holdfast.sim.scenario import load_scenario, shipped
from holdfast.sim.scene import FrameMotion
from holdfast.sim.terrain import Terrain

STEP_S = 1e-4
FRAMES = ("base_link", "cabin", "imu", "lidar", "gnss_left", "base_imu")


def motion(name: str, seed: int = 1) -> Motion:
    scenario = load_scenario(name)
    return Motion(scenario, Terrain(scenario.ground, scenario.objects), seed)


@pytest.fixture(scope="module")
def quick() -> Motion:
    return motion("quick")


@pytest.mark.parametrize("frame", FRAMES)
def test_velocity_acceleration_and_angular_velocity_are_the_derivatives_of_the_pose(quick: Motion, frame: str):
    times = np.linspace(0.0, 20.0, 401)
    before, at, after = (quick.frame(frame, times + shift) for shift in (-STEP_S, 0.0, STEP_S))
    np.testing.assert_allclose(at.v_W, (after.p_W - before.p_W) / (2 * STEP_S), atol=2e-5)
    np.testing.assert_allclose(at.a_W, (after.v_W - before.v_W) / (2 * STEP_S), atol=2e-3)
    turn = Rotation.from_matrix(before.R_W_F.transpose(0, 2, 1) @ after.R_W_F).as_rotvec()
    np.testing.assert_allclose(at.angular_velocity, turn / (2 * STEP_S), atol=2e-5)
    assert np.abs(at.a_W).max() > 0.3
    assert np.abs(at.angular_velocity).max() > 0.02


def test_a_frame_on_the_cabin_keeps_its_place_there(quick: Motion):
    times = np.linspace(0.0, 20.0, 201)
    cabin, lidar = quick.frame("cabin", times), quick.frame("lidar", times)
    in_cabin = np.einsum("nji,nj->ni", cabin.R_W_F, lidar.p_W - cabin.p_W)
    np.testing.assert_allclose(in_cabin, np.broadcast_to([0.85, 0.25, 2.05], (201, 3)), atol=1e-9)


def test_the_cabin_turns_on_the_chassis_by_the_angle_of_the_joint(quick: Motion):
    times = np.linspace(0.0, 20.0, 201)
    base, cabin = quick.frame("base_link", times), quick.frame("cabin", times)
    R = base.R_W_F.transpose(0, 2, 1) @ cabin.R_W_F
    angle, _ = quick.joint(times)
    np.testing.assert_allclose(np.arctan2(R[:, 1, 0], R[:, 0, 0]), angle, atol=1e-4)  # vibration rocks it a little
    assert np.ptp(angle) > 1.2


@pytest.mark.parametrize("name", shipped("scenarios"))
def test_the_driver_keeps_the_limits_of_the_machine(name: str):
    scenario = load_scenario(name)
    moving = motion(name)
    times = np.arange(0.0, scenario.duration_s, 0.05)
    base = moving.frame("base_link", times)
    limits = scenario.drive
    level_m_s = np.hypot(base.v_W[:, 0], base.v_W[:, 1])
    assert level_m_s.max() <= max(limits.speed_m_s, scenario.start.speed_m_s) * 1.001
    assert level_m_s.max() > 0.4
    yaw = np.unwrap(np.arctan2(base.R_W_F[:, 1, 0], base.R_W_F[:, 0, 0]))
    shake_rad_s = 0.1  # yaw of a tilting machine is not the driver's
    assert np.abs(np.gradient(yaw, times)).max() <= limits.yaw_rate_rad_s + shake_rad_s
    assert np.abs(moving.joint(times)[1]).max() <= limits.slew_rate_rad_s * 1.001


@pytest.mark.parametrize("name", shipped("scenarios"))
def test_the_machine_stays_on_its_site_and_on_its_wheels(name: str):
    scenario = load_scenario(name)
    base = motion(name).frame("base_link", np.arange(0.0, scenario.duration_s, 0.1))
    assert np.abs(base.p_W[:, :2]).max() < scenario.ground.size_m / 2 - 15.0
    tilt_deg = np.degrees(np.arccos(base.R_W_F[:, 2, 2]))
    flattest = 0.1 if name in ("gallery", "open-field") else 0.2  # paved, and a meadow
    assert flattest < tilt_deg.max() < 30.0


def test_the_chassis_lies_on_the_ground(quick: Motion):
    scenario = load_scenario("quick")
    terrain = Terrain(scenario.ground, scenario.objects)
    base = quick.frame("base_link", np.arange(0.0, 20.0, 0.1))
    height = terrain.height(base.p_W[:, 0], base.p_W[:, 1])
    assert np.abs(base.p_W[:, 2] - height).max() < 0.05  # tyres bridge bumps of 8 mm sigma
    assert np.ptp(height) > 0.01


def test_the_cabin_vibrates_with_the_engine_as_strongly_as_configured():
    standing = motion("quick").frame("cabin", np.arange(0.5, 2.0, 1e-3))
    in_cabin = np.einsum("nji,nj->ni", standing.R_W_F, standing.a_W)
    np.testing.assert_allclose(in_cabin.std(axis=0) * np.sqrt(2.0), 0.08, rtol=0.1)


def test_the_same_seed_moves_the_machine_alike_and_another_seed_otherwise():
    times = np.linspace(0.0, 20.0, 500)

    def place(seed: int) -> FrameMotion:
        return motion("quick", seed).frame("imu", times)

    assert np.array_equal(place(3).a_W, place(3).a_W)
    assert not np.array_equal(place(3).a_W, place(4).a_W)


def test_a_moving_start_is_in_motion_from_the_first_moment():
    base = motion("moving-start").frame("base_link", np.array([0.0, 0.5]))
    assert np.linalg.norm(base.v_W, axis=1).min() > 3.0
