"""The lidar as a witness: silent while the odometry drifts as it may, heard when the fixes walk away."""

import gtsam
import numpy as np
import pytest

from holdfast.config.model import LidarConfig
from holdfast.estimator.witness import LidarWitness
from holdfast.graph.scans import Scan
from holdfast.sensors.lidar import LidarModel

CONFIG = LidarConfig(topic="/lidar")
KNOWN = np.eye(9) * 0.01**2
SPEED_M_S = 1.5


def way(t_s, speed_m_s=SPEED_M_S):
    """A circle of 20 m radius."""
    angle = speed_m_s * t_s / 20.0
    place = np.array([20.0 * np.sin(angle), 20.0 * (1.0 - np.cos(angle)), 0.0])
    return gtsam.Pose3(gtsam.Rot3.Yaw(angle), place)


def nothing(_t):
    return np.zeros(3)


def watch(seconds, walk=nothing, rng=None, *, slip_from_s=np.inf, drift=1.0, speed_m_s=SPEED_M_S):
    """What the witness says each second: the odometry drifts as configured times `drift`, GNSS walks."""
    witness, lidar = LidarWitness(LidarModel(CONFIG, gtsam.Pose3())), LidarModel(CONFIG, gtsam.Pose3())
    track, before, found = gtsam.Pose3(), way(0.0, speed_m_s), []
    for t in np.arange(0.0, seconds, 1.0):
        here = way(t, speed_m_s)
        motion = before.between(here)
        if rng is not None:
            motion = motion * gtsam.Pose3.Expmap(drift * rng.normal(0.0, lidar.drift(motion, 1.0)))
        before, track = (
            here,
            track * motion * gtsam.Pose3(gtsam.Rot3(), np.array([-1.0 if t > slip_from_s else 0.0, 0.0, 0.0])),
        )
        noise = np.zeros(3) if rng is None else rng.normal(0.0, 0.007, 3)
        estimate = gtsam.Pose3(here.rotation(), here.translation() + walk(t) + noise)
        contradiction = witness.observe(Scan(round(t * 1e9), track), estimate, KNOWN)
        if contradiction is not None:
            found.append((t, contradiction))
    return found


@pytest.mark.parametrize("drift", [0.3, 1.0])
def test_an_honest_odometry_and_honest_fixes_are_never_accused(drift):
    for seed in range(20):
        assert not watch(300.0, rng=np.random.default_rng(seed), drift=drift)


def test_an_odometry_three_times_worse_than_configured_is_learnt_and_not_taken_for_walking_fixes():
    accused = sum(bool(watch(300.0, rng=np.random.default_rng(seed), drift=3.0)) for seed in range(20))
    assert accused <= 2


@pytest.mark.parametrize(("speed_m_s", "walk_m_s"), [(0.0, 0.08), (SPEED_M_S, 0.2)])
def test_fixes_that_walk_are_found_within_five_seconds(speed_m_s, walk_m_s):
    """While driving the odometry may drift as well: there slow walks take longer to see."""

    def walk(t):
        return np.array([walk_m_s * max(0.0, t - 60.0), 0.0, 0.0])

    for seed in range(10):
        found = watch(90.0, walk, np.random.default_rng(seed), drift=0.2, speed_m_s=speed_m_s)  # 1 cm per root metre
        assert found and 60.0 < found[0][0] < 65.5
        assert not found[0][1].is_slip


def test_the_correction_leads_back_to_where_the_lidar_sees_the_machine():
    def walk(t):
        return np.array([0.0, 0.1 * max(0.0, t - 30.0), 0.0])

    t, found = watch(60.0, walk)[0]
    back = found.T_W_I0 * way(t)  # the odometry did not drift
    # against where it was when the two still agreed
    agreed_s = found.since_ns * 1e-9
    np.testing.assert_allclose(back.translation(), way(t).translation() + walk(agreed_s), atol=1e-6)
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


def test_in_the_first_half_minute_it_has_learnt_nothing_and_says_nothing():
    assert not watch(30.0, lambda t: np.array([0.2 * t, 0.0, 0.0]))
