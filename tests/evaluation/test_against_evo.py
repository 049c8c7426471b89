"""evo (GPL-3) is the outside judge of the judge; the package itself never imports it."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.metrics import PoseRelation
from evo.core.trajectory import PoseTrajectory3D
from evo.core.units import Unit

from holdfast.evaluation.absolute import ape, summarise
from holdfast.evaluation.alignment import align
from holdfast.evaluation.association import Association, associate
from holdfast.evaluation.relative import rpe
from holdfast.state import Trajectory

RELATIONS = [("translation_part", "translation_m"), ("rotation_angle_deg", "rotation_deg")]


def to_evo(trajectory):
    return PoseTrajectory3D(
        trajectory.positions, np.roll(trajectory.quaternions, 1, axis=1), trajectory.stamps_ns * 1e-9
    )


def every(trajectory, step, shift_ns=0):
    return Trajectory(
        trajectory.stamps_ns[::step] + shift_ns, trajectory.positions[::step], trajectory.quaternions[::step]
    )


@pytest.mark.parametrize(("relation", "name"), RELATIONS)
@pytest.mark.parametrize("alignment", ["none", "se3"])
def test_absolute_error_equals_that_of_evo(wander, disturbed, relation, name, alignment):
    reference = wander()
    estimate = disturbed(reference)
    pairs = associate(estimate, reference)
    ours = ape(align(pairs, alignment).apply(pairs))[name]
    theirs = metrics.APE(PoseRelation[relation])
    judged = to_evo(estimate)
    if alignment == "se3":
        judged.align(to_evo(reference))
    theirs.process_data((to_evo(reference), judged))
    np.testing.assert_allclose(ours, theirs.error, atol=1e-9)


def test_statistics_equal_those_of_evo(wander, disturbed):
    reference = wander()
    estimate = disturbed(reference)
    ours = summarise(ape(associate(estimate, reference))["translation_m"])
    theirs = metrics.APE(PoseRelation.translation_part)
    theirs.process_data((to_evo(reference), to_evo(estimate)))
    expected = theirs.get_all_statistics()
    for name, key in [("mean", "mean"), ("std", "std"), ("rms", "rmse"), ("median", "median"), ("max", "max")]:
        assert getattr(ours, name) == pytest.approx(expected[key], rel=1e-12)


@pytest.mark.parametrize("pairing", ["all", "consecutive"])
@pytest.mark.parametrize(("delta", "unit"), [(5.0, "m"), (0.7, "m"), (7, "frames")])
def test_relative_errors_equal_those_of_evo(wander, disturbed, pairing, delta, unit):
    reference = wander()
    estimate = disturbed(reference)
    ours = rpe(associate(estimate, reference), delta, unit, pairing)
    for relation, name in RELATIONS:
        theirs = metrics.RPE(
            PoseRelation[relation],
            delta,
            Unit.meters if unit == "m" else Unit.frames,
            0.1,
            all_pairs=pairing == "all",
            pairs_from_reference=True,
        )
        theirs.process_data((to_evo(reference), to_evo(estimate)))
        assert len(theirs.error) > 3
        assert ours.second.tolist() == [int(index) for index in theirs.delta_ids]
        np.testing.assert_allclose(ours.errors[name], theirs.error, atol=1e-9)


def test_pairs_of_a_reference_that_stops_and_goes_are_those_of_evo(wander, disturbed):
    """Whole metres and stops make ends that are equally near: evo takes the first."""
    truth = wander(count=60)
    steps = np.tile([0.0, 0.0, 1.0, 1.0, 0.0, 2.0], 10)
    truth = replace(truth, positions=np.cumsum(steps)[:, None] * np.array([1.0, 0.0, 0.0]))
    for delta in (1.0, 2.0, 3.0):
        theirs = metrics.RPE(PoseRelation.translation_part, delta, Unit.meters, 0.5, True, True)
        theirs.process_data((to_evo(truth), to_evo(disturbed(truth))))
        ours = rpe(associate(disturbed(truth), truth), delta, "m", "all", tolerance=0.5)
        assert len(theirs.error) > 20
        assert ours.second.tolist() == [int(index) for index in theirs.delta_ids]
        np.testing.assert_allclose(ours.errors["translation_m"], theirs.error, atol=1e-9)


def test_relative_error_in_percent_is_that_of_evo_per_way(wander, disturbed):
    reference = wander()
    pairs = associate(disturbed(reference), reference)
    result = rpe(pairs, 5.0)
    distance = pairs.driven_m()[result.second] - pairs.driven_m()[result.first]
    np.testing.assert_allclose(result.errors["translation_percent"], 100.0 * result.errors["translation_m"] / distance)


@pytest.mark.parametrize(("reference_step", "estimate_step"), [(4, 1), (1, 3), (1, 1)])
def test_nearest_stamps_are_those_that_evo_takes(wander, disturbed, reference_step, estimate_step):
    truth = wander()
    reference = every(truth, reference_step)
    estimate = every(disturbed(truth), estimate_step, shift_ns=7_000_000)
    ours = associate(estimate, reference, Association(method="nearest", max_difference_s=0.03))
    theirs_reference, theirs_estimate = sync.associate_trajectories(
        copy.deepcopy(to_evo(reference)), copy.deepcopy(to_evo(estimate)), max_diff=0.03
    )
    np.testing.assert_array_equal(ours.reference.positions, theirs_reference.positions_xyz)
    np.testing.assert_array_equal(ours.estimate.positions, theirs_estimate.positions_xyz)
