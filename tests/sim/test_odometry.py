import numpy as np
import pytest
from sampled import sampled
from scipy.spatial.transform import Rotation

from holdfast.sim.readings import generator
from holdfast.sim.scene import FrameMotion
from holdfast.sim.sensors.odometry import SimulatedOdometry

PERFECT = {
    "jitter_m": 0.0,
    "jitter_rad": 0.0,
    "drift_m_per_sqrt_m": 0.0,
    "drift_rad_per_sqrt_m": 0.0,
    "drift_rad_per_sqrt_rad": 0.0,
}


def datasheet(**values):
    return SimulatedOdometry(
        **{"kind": "odometry", "topic": "/lidar", "frame": "lidar", "rate_hz": 5.0} | PERFECT | values
    )


def motion(attitude, p_W):
    zero = np.zeros_like(p_W)
    return FrameMotion(attitude.as_matrix(), p_W, zero, zero, zero)


def straight(distance_m, count, tilted=True):
    """A drive of `distance_m` along the lidar's x axis, which points anywhere in W."""
    attitude = Rotation.from_euler("ZYX", [0.7, -0.2, 0.1] if tilted else [0.0, 0.0, 0.0])
    p_F0 = np.outer(np.linspace(0.0, distance_m, count), [1.0, 0.0, 0.0])
    return motion(Rotation.concatenate([attitude] * count), attitude.apply(p_F0) + np.array([5.0, -3.0, 2.0]))


def spin(rotation_rad, count):
    """A rotation in place."""
    return motion(Rotation.from_euler("z", np.linspace([0.3], [0.3 + rotation_rad], count)), np.ones((count, 3)))


def measure(lidar, seed=0, **sheet):
    times_s = np.arange(len(lidar.p_W)) * 0.2
    return sampled(datasheet(**sheet), lidar, times_s, generator(seed, "lidar"))


def errors(lidar, row, seeds=400, **sheet):
    """Errors of one row over seeds: translation in L0 [m] and rotation vector [rad], each (seeds, 3)."""
    true = measure(lidar).values
    translations, rotations = [], []
    for seed in range(seeds):
        pose = measure(lidar, seed, **sheet).values
        translations.append(pose["position"][row] - true["position"][row])
        rotations.append(
            (
                Rotation.from_quat(true["quaternion"][row]).inv() * Rotation.from_quat(pose["quaternion"][row])
            ).as_rotvec()
        )
    return np.array(translations), np.array(rotations)


def test_without_noise_the_poses_are_the_motion_seen_from_the_first_pose():
    rng = np.random.default_rng(0)
    attitude = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.2, (200, 3)), axis=0))
    p_W = np.cumsum(rng.normal(size=(200, 3)), axis=0)
    poses = measure(motion(attitude, p_W)).values
    np.testing.assert_allclose(poses["position"], attitude[0].inv().apply(p_W - p_W[0]), atol=1e-10)
    difference = Rotation.from_quat(poses["quaternion"]).inv() * (attitude[0].inv() * attitude)
    assert difference.magnitude().max() < 1e-10
    np.testing.assert_allclose(poses["position"][0], 0.0)


@pytest.mark.parametrize("count", [26, 101])
def test_position_drift_grows_with_the_root_of_the_distance_whatever_the_rate(count):
    for share in (0.25, 1.0):
        translations, rotations = errors(straight(20.0, count), round(share * (count - 1)), drift_m_per_sqrt_m=0.05)
        np.testing.assert_allclose(np.std(translations, axis=0), 0.05 * np.sqrt(20.0 * share), rtol=0.12)
        assert np.abs(rotations).max() < 1e-12


def test_attitude_drift_grows_with_the_root_of_the_distance():
    lidar = straight(30.0, 121)
    for row, distance_m in ((30, 7.5), (120, 30.0)):
        _, rotations = errors(lidar, row, drift_rad_per_sqrt_m=1e-3)
        np.testing.assert_allclose(np.std(rotations, axis=0), 1e-3 * np.sqrt(distance_m), rtol=0.12)


def test_attitude_drift_grows_with_the_root_of_the_rotation():
    lidar = spin(12.0, 121)
    for row, rotation_rad in ((30, 3.0), (120, 12.0)):
        translations, rotations = errors(lidar, row, drift_rad_per_sqrt_rad=1e-3)
        np.testing.assert_allclose(np.std(rotations, axis=0), 1e-3 * np.sqrt(rotation_rad), rtol=0.12)
        assert np.abs(translations).max() < 1e-12


def test_attitude_drift_bends_the_path():
    # sideways error is the integral of a random walk: sigma = density * sqrt(distance^3 / 3)
    translations, _ = errors(straight(30.0, 301, tilted=False), 300, drift_rad_per_sqrt_m=1e-3)
    np.testing.assert_allclose(np.std(translations[:, 1:], axis=0), 1e-3 * np.sqrt(30.0**3 / 3.0), rtol=0.12)
    assert np.abs(translations[:, 0]).max() < 5e-3


def test_a_lidar_that_stands_does_not_drift():
    lidar = straight(0.0, 500)
    poses = measure(lidar, 1, drift_m_per_sqrt_m=1.0, drift_rad_per_sqrt_m=0.5, drift_rad_per_sqrt_rad=0.5).values
    assert np.abs(poses["position"]).max() < 1e-9
    assert Rotation.from_quat(poses["quaternion"]).magnitude().max() < 1e-9


def test_jitter_does_not_accumulate():
    poses = measure(straight(0.0, 4000), 2, jitter_m=0.01, jitter_rad=2e-3).values
    rotations = Rotation.from_quat(poses["quaternion"]).as_rotvec()
    for part in (slice(0, 2000), slice(2000, 4000)):
        np.testing.assert_allclose(np.std(poses["position"][part], axis=0), 0.01, rtol=0.08)
        np.testing.assert_allclose(np.std(rotations[part], axis=0), 2e-3, rtol=0.08)
    steps = np.diff(poses["position"], axis=0)
    np.testing.assert_allclose(np.std(steps, axis=0), 0.01 * np.sqrt(2.0), rtol=0.08)


def test_the_claim_is_the_jitter_translation_first():
    poses = measure(straight(10.0, 20), jitter_m=0.005, jitter_rad=3e-4, drift_m_per_sqrt_m=1.0).values
    np.testing.assert_allclose(poses["covariance"], np.tile([25e-6] * 3 + [9e-8] * 3, (20, 1)))


def test_quaternions_have_unit_norm_after_an_hour():
    poses = measure(spin(600.0, 18_000), 3, drift_rad_per_sqrt_rad=1e-3, jitter_rad=1e-3).values
    np.testing.assert_allclose(np.linalg.norm(poses["quaternion"], axis=1), 1.0, atol=1e-12)


def test_one_pose_alone_is_the_identity():
    poses = measure(straight(0.0, 1)).values
    np.testing.assert_allclose(poses["position"], np.zeros((1, 3)))
    np.testing.assert_allclose(np.abs(poses["quaternion"]), [[0.0, 0.0, 0.0, 1.0]])


def test_identical_seeds_give_identical_bytes_and_others_do_not():
    lidar = straight(10.0, 50)
    first, again, other = (
        measure(lidar, seed, drift_m_per_sqrt_m=0.1).values["position"].tobytes() for seed in (3, 3, 4)
    )
    assert first == again != other
