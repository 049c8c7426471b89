"""The simulated source of absolute poses: errors and the offset of its frame."""

import numpy as np
import pytest
from sampled import sampled
from scipy.spatial.transform import Rotation

from holdfast.sim.readings import generator
from holdfast.sim.scene import FrameMotion
from holdfast.sim.sensors.pose import SimulatedPose

TIMES = np.arange(0.0, 200.0, 0.2)
PERFECT = dict.fromkeys(("jitter_m", "jitter_rad", "slow_m", "slow_rad"), 0.0)
P_W = np.stack([TIMES, np.sin(TIMES), 0.1 * TIMES], axis=1)
ATTITUDE = Rotation.from_euler("ZYX", np.stack([0.3 * TIMES, 0.1 + 0.0 * TIMES, np.sin(TIMES)], axis=1))


def read(seed=1, **errors):
    sheet = SimulatedPose(kind="pose", topic="/p", frame="f", rate_hz=5.0, **PERFECT | errors)
    zero = np.zeros_like(P_W)
    moving = FrameMotion(ATTITUDE.as_matrix(), P_W, zero, zero, zero)
    return sampled(sheet, moving, TIMES, generator(seed, "pose")).values


def errors_of(values):
    """Return the errors of position (N, 3) [m] and attitude (N, 3) [rad]."""
    return values["position"] - P_W, (ATTITUDE.inv() * Rotation.from_quat(values["quaternion"])).as_rotvec()


def test_a_perfect_source_reports_the_pose_in_w():
    for error in errors_of(read()):
        np.testing.assert_allclose(error, 0.0, atol=1e-12)


def test_a_source_with_a_frame_of_its_own_reports_the_pose_in_it():
    values = read(offset_m=(100.0, -50.0, 3.0), offset_yaw_deg=30.0)
    R_W_M = Rotation.from_euler("z", 30.0, degrees=True)
    attitude_W = R_W_M * Rotation.from_quat(values["quaternion"])
    position_W = R_W_M.apply(values["position"]) + np.array([100.0, -50.0, 3.0])
    for error in errors_of({"position": position_W, "quaternion": attitude_W.as_quat()}):
        np.testing.assert_allclose(error, 0.0, atol=1e-10)


def test_jitter_is_white_and_of_the_datasheets_sigma():
    for error, sigma in zip(errors_of(read(jitter_m=0.05, jitter_rad=0.01)), (0.05, 0.01), strict=True):
        np.testing.assert_allclose(error.std(axis=0), sigma, rtol=0.08)
        assert np.abs(np.mean(error[1:] * error[:-1], axis=0)).max() < 0.12 * sigma**2


def test_the_slow_error_stays_for_its_time_constant():
    runs = [errors_of(read(seed, slow_m=0.1, slow_rad=0.02, time_constant_s=4.0)) for seed in range(60)]
    for error, sigma in zip((np.array(part) for part in zip(*runs, strict=True)), (0.1, 0.02), strict=True):
        assert error.std() == pytest.approx(sigma, rel=0.05)
        assert np.mean(error[:, 20:] * error[:, :-20]) == pytest.approx(np.exp(-1.0) * sigma**2, rel=0.2)


def test_claims_are_honest():
    values = read(jitter_m=0.03, slow_m=0.04, jitter_rad=0.006, slow_rad=0.008)
    np.testing.assert_allclose(values["covariance"][0], [0.05**2] * 3 + [0.01**2] * 3)


def test_equal_seeds_give_equal_bytes_and_others_do_not():
    first, again, other = (read(seed, jitter_m=0.1)["position"].tobytes() for seed in (3, 3, 4))
    assert first == again != other
