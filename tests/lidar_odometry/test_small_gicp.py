"""The covariance that our adapter makes of small_gicp's Hessian."""

import gtsam
import numpy as np
import pytest
from yard import BOXES, T_W_L, cast, rays_that_return, standing

pytest.importorskip("small_gicp")

from holdfast.lidar_odometry.small_gicp import SmallGicp, covariance

WALLS = BOXES[[0, 1, 4, 6]]  # two long walls and two boxes: the lidar knows its x better than its y
FAR = gtsam.Pose3(gtsam.Rot3.Yaw(1.4), np.array([150.0, 90.0, 0.0]))  # with a long lever a wrong tangent shows
GUESS_SIGMAS = np.array([0.003, 0.003, 0.003, 0.02, 0.02, 0.02])


@pytest.fixture(scope="module")
def alignments():
    """Errors (N, 6) in the tangent of L and claimed covariances, over noise and positions, against one map."""
    rng = np.random.default_rng(8)
    rays = rays_that_return(rng)
    odometry = SmallGicp(1)

    def cloud(moved):
        pose = T_W_L(0.0, standing).compose(moved)
        origins = np.tile(pose.translation(), (len(rays), 1))
        distance = cast(origins, rays @ pose.rotation().matrix().T, WALLS)
        seen = distance < 60.0
        distance = distance[seen] + rng.normal(0, 0.02, int(seen.sum()))
        return odometry._planes(rays[seen] * distance[:, None], 0.35, None).cloud

    for _ in range(8):
        moved = gtsam.Pose3.Expmap(rng.normal(0, [0.01, 0.01, 0.3, 0.4, 0.4, 0.05]))
        odometry._map._voxels.insert(cloud(moved), FAR.compose(moved).matrix())
    errors, covariances = [], []
    for _ in range(40):
        moved = gtsam.Pose3.Expmap(rng.normal(0, [0.01, 0.01, 0.1, 0.3, 0.3, 0.05]))
        truth = FAR.compose(moved)
        result = odometry._map.align(cloud(moved), truth.compose(gtsam.Pose3.Expmap(rng.normal(0, GUESS_SIGMAS))))
        errors.append(gtsam.Pose3.Logmap(truth.between(gtsam.Pose3(result.T_target_source))))
        covariances.append(covariance(result))
    return np.array(errors), np.array(covariances)


def nees(errors, covariances):
    """Normalised squared error per degree of freedom; 1 for an honest covariance."""
    return np.mean([e @ np.linalg.solve(c, e) for e, c in zip(errors, covariances, strict=True)]) / 6


def test_the_covariance_is_that_of_the_errors(alignments):
    assert 0.4 < nees(*alignments) < 2.5


def test_each_axis_has_its_own_sigma(alignments):
    errors, covariances = alignments
    claimed = np.sqrt(covariances.mean(axis=0).diagonal())
    ratio = errors.std(axis=0) / claimed
    assert (ratio > 0.3).all()
    assert (ratio < 2.5).all()
    assert claimed[4] > 1.5 * claimed[3]


def test_any_other_order_or_frame_would_be_far_off(alignments):
    errors, covariances = alignments
    other = FAR.AdjointMap()
    assert nees(errors, [other @ c @ other.T for c in covariances]) > 10 or nees(errors @ other.T, covariances) > 10
    translation_first = covariances[:, [3, 4, 5, 0, 1, 2]][:, :, [3, 4, 5, 0, 1, 2]]
    assert nees(errors, translation_first) > 10
