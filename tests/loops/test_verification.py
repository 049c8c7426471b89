"""A registration is accepted only if the submaps show the same place, and says how well each direction is known."""

import gtsam
import numpy as np
import pytest

small_gicp = pytest.importorskip("small_gicp")

from holdfast.loops.verification import Target, verified  # noqa: E402 (it needs the library)

DOUBT = np.diag(np.repeat([0.02, 0.3], 3) ** 2)
MOVED = gtsam.Pose3(gtsam.Rot3.Rz(0.4), np.array([2.0, 1.0, 0.1]))


def plane(rng, count, low, high):
    return rng.uniform(low, high, (count, 3)) + rng.normal(0.0, 0.01, (count, 3))


def yard(seed, corner=True):
    """A floor, and two walls and a box unless it is bare."""
    rng = np.random.default_rng(seed)
    parts = [plane(rng, 8000, [-15, -15, 0], [15, 15, 1e-9])]
    if corner:
        parts += [
            plane(rng, 4000, [12, -15, 0], [12 + 1e-9, 15, 4]),
            plane(rng, 4000, [-15, 11, 0], [15, 11 + 1e-9, 4]),
            plane(rng, 1500, [-6, -5, 0], [-6 + 1e-9, -2, 2]),
            plane(rng, 1500, [-6, -5, 0], [-3, -5 + 1e-9, 2]),
        ]
    return np.concatenate(parts)


def target(points):
    cloud = small_gicp.preprocess_points(points, 0.25, 10, 1)[0]
    return Target(cloud, small_gicp.KdTree(cloud))


def seen_from(pose, points):
    return (points - pose.translation()) @ pose.rotation().matrix()


def off_by(rotation, translation):
    return MOVED.compose(gtsam.Pose3(gtsam.Rot3.Expmap(np.array(rotation)), np.array(translation)))


def test_the_same_place_is_found_from_a_prediction_that_is_off():
    match = verified(target(yard(0)), target(seen_from(MOVED, yard(1))), off_by([0, 0, 0.02], [0.3, -0.2, 0.1]), DOUBT)
    off = gtsam.Pose3.Logmap(MOVED.between(match.T))
    assert match.refusal == ""
    assert np.linalg.norm(off[:3]) < 2e-3 and np.linalg.norm(off[3:]) < 0.02
    assert off @ np.linalg.solve(match.covariance, off) < 22.5


def test_another_place_is_refused():
    rng = np.random.default_rng(2)
    elsewhere = np.concatenate([rng.uniform([-15, -15, 2.0], [15, 15, 8.0], (6000, 3))])
    match = verified(target(yard(0)), target(seen_from(MOVED, elsewhere)), MOVED, DOUBT)
    assert match.refusal


def test_a_result_far_from_a_sure_prediction_is_refused():
    sure = np.diag(np.repeat([1e-4, 1e-3], 3) ** 2)
    wrong = off_by([0.0, 0.0, 0.0], [0.4, 0.0, 0.0])
    match = verified(target(yard(0)), target(seen_from(MOVED, yard(1))), wrong, sure)
    assert match.refusal == "far from the estimate"


def test_bare_ground_says_nothing_of_where_on_it_and_a_yard_does():
    sigmas = []
    for corner in (False, True):
        match = verified(target(yard(0, corner)), target(seen_from(MOVED, yard(1, corner))), MOVED, DOUBT)
        sigmas.append(np.sqrt(np.diag(match.covariance)[3:]))
    bare, built = sigmas
    assert bare[:2].min() > 0.1
    assert max(bare[2], built.max()) < 0.02
