import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.sim.readings import generator
from holdfast.sim.sensors.gnss import Antenna, Quality
from holdfast.sim.sensors.heading import SimulatedHeading, heading_readings

ARMS_M = {"left": [-0.5, 1.0, 2.0], "right": [-0.5, -1.0, 2.0]}


def datasheet(**values):
    return SimulatedHeading(
        **{
            "kind": "heading",
            "topic": "/heading",
            "frame": "gnss",
            "rate_hz": 10.0,
            "white_rad": 1.5e-3,
            "slow_rad": 8e-4,
        }
        | values
    )


def antenna(arm_m, attitude, quality):
    """An antenna of a body with these attitudes (N)."""
    p_W = attitude.as_matrix() @ arm_m + np.array([10.0, 20.0, 30.0])
    return Antenna(None, np.arange(len(p_W)) * 0.1, p_W, np.broadcast_to(np.int64(quality), len(p_W)))


def measure(yaw_rad, seed=0, left=Quality.RTK_FIXED, right=Quality.RTK_FIXED, roll_pitch_rad=(0.0, 0.0), **sheet):
    yaw_rad = np.asarray(yaw_rad)
    angles = np.stack([yaw_rad, *(np.full(yaw_rad.shape, angle) for angle in roll_pitch_rad[::-1])], axis=1)
    attitude = Rotation.from_euler("ZYX", angles)
    ends = (antenna(ARMS_M[side], attitude, quality) for side, quality in (("left", left), ("right", right)))
    return heading_readings(datasheet(**sheet), *ends, generator(seed, "heading"))


def test_yaw_is_that_of_the_baseline_from_left_to_right():
    # the right antenna of a machine that looks east lies in the south
    yaw = measure([0.0, np.pi / 2, np.pi, -2.0], white_rad=0.0, slow_rad=0.0).values["yaw_rad"]
    np.testing.assert_allclose(yaw, [-np.pi / 2, 0.0, np.pi / 2, 1.5 * np.pi - 2.0])


def test_only_the_horizontal_projection_of_a_tilted_baseline_counts():
    yaw = measure([0.3] * 3, roll_pitch_rad=(0.2, 0.0), white_rad=0.0, slow_rad=0.0).values["yaw_rad"]
    np.testing.assert_allclose(yaw, 0.3 - np.pi / 2)
    both = measure([0.3] * 3, roll_pitch_rad=(0.2, 0.1), white_rad=0.0, slow_rad=0.0).values["yaw_rad"]
    baseline = Rotation.from_euler("ZYX", [0.3, 0.1, 0.2]).apply([0.0, -1.0, 0.0])
    np.testing.assert_allclose(both, np.arctan2(baseline[1], baseline[0]))


def test_yaw_is_wrapped():
    yaw = measure(np.full(1000, -np.pi / 2), white_rad=0.01).values["yaw_rad"]
    assert np.all(np.abs(yaw) <= np.pi) and yaw.max() > 3.1 and yaw.min() < -3.1


@pytest.mark.parametrize(("left", "sigma_rad"), [(Quality.RTK_FIXED, 1.7e-3), (Quality.RTK_FLOAT, 17e-3)])
def test_claims_are_honest(left, sigma_rad):
    ratios = []
    for seed in range(100):
        heading = measure(np.zeros(3000), seed, left).values
        error = heading["yaw_rad"] + np.pi / 2
        ratios.append(np.mean((error / heading["sigma_rad"]) ** 2))
        np.testing.assert_allclose(heading["sigma_rad"], sigma_rad)
    assert 0.9 < np.mean(ratios) < 1.1


def test_the_slow_error_stays_for_its_time_constant():
    errors = [
        measure(np.zeros(1200), seed, white_rad=0.0, time_constant_s=20.0).values["yaw_rad"] for seed in range(99)
    ]
    errors = np.array(errors) + np.pi / 2
    lag = 200
    correlation = np.mean(errors[:, :-lag] * errors[:, lag:]) / np.mean(errors**2)
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.1)


def test_there_is_no_heading_without_both_antennas():
    left, right = np.array([3, 3, 1, 2, 0, 3]), np.array([3, 1, 3, 2, 3, 2])
    heading = measure(np.zeros(6), left=left, right=right)
    np.testing.assert_allclose(heading.times_s, [0.0, 0.3, 0.5])
    sigma = np.hypot(1.5e-3, 8e-4)
    np.testing.assert_allclose(heading.values["sigma_rad"], [sigma, 10 * sigma, 10 * sigma])


def test_identical_seeds_give_identical_bytes_and_others_do_not():
    first, again, other = (measure(np.zeros(50), seed).values["yaw_rad"].tobytes() for seed in (3, 3, 4))
    assert first == again != other
