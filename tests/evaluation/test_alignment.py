from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from holdfast.errors import RecordingError
from holdfast.evaluation.absolute import ape
from holdfast.evaluation.alignment import align
from holdfast.evaluation.association import associate
from holdfast.evaluation.relative import rpe


def moved(trajectory, rotation, translation):
    return replace(
        trajectory,
        positions=rotation.apply(trajectory.positions) + translation,
        quaternions=(rotation * Rotation.from_quat(trajectory.quaternions)).as_quat(),
    )


def residual(pairs, name):
    return ape(align(pairs, name).apply(pairs))


def test_no_alignment_changes_nothing(wander, disturbed):
    pairs = associate(disturbed(wander()), wander())
    np.testing.assert_array_equal(align(pairs, "none").apply(pairs).estimate.positions, pairs.estimate.positions)


@pytest.mark.parametrize("yaw", [-3.1, -1.0, 0.0, 0.3, np.pi])
def test_yaw_alignment_undoes_yaw_and_translation_and_nothing_else(wander, yaw):
    reference = wander()
    pairs = associate(moved(reference, Rotation.from_euler("z", yaw), [10.0, -20.0, 3.0]), reference)
    assert residual(pairs, "yaw")["translation_m"].max() < 1e-11
    assert residual(pairs, "yaw")["rotation_deg"].max() < 1e-11
    tilted = associate(moved(reference, Rotation.from_euler("x", 0.1), [0.0, 0.0, 0.0]), reference)
    assert residual(tilted, "yaw")["translation_m"].max() > 0.1


@given(seed=st.integers(0, 1000))
def test_se3_alignment_undoes_any_rigid_motion(wander, seed):
    reference = wander(count=50)
    pairs = associate(moved(reference, Rotation.random(rng=seed), [10.0, -20.0, 3.0]), reference)
    assert residual(pairs, "se3")["translation_m"].max() < 1e-11
    assert residual(pairs, "se3")["rotation_deg"].max() < 1e-11


def test_yaw_alignment_is_the_minimum_of_the_squared_distances(wander, disturbed):
    reference = wander()
    pairs = associate(moved(disturbed(reference), Rotation.from_euler("z", 0.4), [1.0, 2.0, 3.0]), reference)
    points = pairs.estimate.positions - pairs.estimate.positions.mean(axis=0)
    targets = pairs.reference.positions - pairs.reference.positions.mean(axis=0)

    def squares(yaw):
        return np.sum((Rotation.from_euler("z", yaw).apply(points) - targets) ** 2)

    best = minimize_scalar(squares, bounds=(-1.5, 1.5), options={"xatol": 1e-10})
    assert np.sum(residual(pairs, "yaw")["translation_m"] ** 2) == pytest.approx(best.fun, rel=1e-10)


def test_more_freedom_never_fits_worse(wander, disturbed):
    pairs = associate(disturbed(wander()), wander())
    none, yaw, se3 = (np.sum(residual(pairs, name)["translation_m"] ** 2) for name in ("none", "yaw", "se3"))
    assert se3 < yaw < none


def test_alignment_does_not_change_relative_errors(wander, disturbed):
    pairs = associate(disturbed(wander()), wander())
    before, after = rpe(pairs, 5.0), rpe(align(pairs, "se3").apply(pairs), 5.0)
    for name, values in before.errors.items():
        np.testing.assert_allclose(after.errors[name], values, atol=1e-9)


def test_alignments_that_the_tracks_do_not_determine_are_refused(wander):
    still = replace(wander(), positions=np.ones((400, 3)))
    straight = replace(wander(), positions=np.arange(400.0)[:, None] * [1.0, 2.0, 0.5])
    with pytest.raises(RecordingError, match="--align none"):
        align(associate(still, still), "yaw")
    with pytest.raises(RecordingError, match="--align yaw"):
        align(associate(straight, straight), "se3")
    assert residual(associate(straight, straight), "yaw")["translation_m"].max() < 1e-10
