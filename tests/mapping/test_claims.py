"""Sigmas of points: what an error of the pose does to them, by sampling; and covariances as smooth writes them."""

from pathlib import Path

import gtsam
import numpy as np
import pytest

from holdfast.errors import RecordingError
from holdfast.mapping.claims import SMOOTHED, PoseCovariances, read_pose_covariances
from holdfast.recording.covariance_csv import HEADER
from holdfast.state import Trajectory

R_W_I = gtsam.Rot3.RzRyRx(0.3, -0.4, 1.9)


def covariance(seed: int, size: int) -> np.ndarray:
    factor = 0.01 * np.random.default_rng(seed).standard_normal((size, size))
    return factor @ factor.T


def test_sigmas_are_those_of_sampled_poses():
    P, lever = covariance(1, 6), np.array([8.0, -5.0, 2.0])
    claimed = PoseCovariances(np.zeros(1, dtype=np.int64), P[None]).sigmas(0, lever[None])
    errors = np.random.default_rng(0).multivariate_normal(np.zeros(6), P, 20_000)
    moved = [error[:3] + gtsam.Rot3.Expmap(error[3:]).matrix() @ lever - lever for error in errors]
    assert claimed[0] == pytest.approx(np.sqrt(np.var(moved, axis=0).sum()), rel=0.03)


def test_covariances_of_smooth_are_brought_from_the_axes_of_I_to_those_of_W(tmp_path: Path):
    P, stamp_ns, lever = covariance(2, 9), 1_700_000_000_000_000_000, np.array([3.0, 1.0, -2.0])
    cells = ",".join(f"{value:.12g}" for value in P[np.triu_indices(9)])
    (tmp_path / SMOOTHED).write_text(f"{','.join(HEADER)}\n{stamp_ns},{cells}\n")
    poses = Trajectory(np.array([stamp_ns]), np.zeros((1, 3)), R_W_I.toQuaternion().coeffs()[None])
    found = read_pose_covariances(tmp_path, poses)
    assert found is not None
    # rotation and position perturb the pose in its own axes: p + R dp, R Exp(dtheta)
    errors = np.random.default_rng(0).multivariate_normal(np.zeros(9), P, 20_000)
    in_imu = R_W_I.unrotate(lever)
    moved = [
        R_W_I.rotate(error[3:6]) + R_W_I.compose(gtsam.Rot3.Expmap(error[:3])).rotate(in_imu) - lever
        for error in errors
    ]
    sigma = found.sigmas(stamp_ns, lever[None])[0]
    assert sigma == pytest.approx(np.sqrt(np.var(moved, axis=0).sum()), rel=0.03)


def test_a_table_that_is_none_is_told(tmp_path: Path):
    poses = Trajectory(np.array([0]), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    assert read_pose_covariances(tmp_path, poses) is None
    for text in ("stamp_ns,a\n1,2\n", "stamp_ns\n1,x\n"):
        (tmp_path / SMOOTHED).write_text(text)
        with pytest.raises(RecordingError, match="is no table of covariances"):
            read_pose_covariances(tmp_path, poses)
