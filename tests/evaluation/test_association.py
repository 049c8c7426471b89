from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.errors import ConfigError, RecordingError
from holdfast.evaluation.absolute import ape
from holdfast.evaluation.association import Association, associate
from holdfast.state import Trajectory

SECOND = 1_000_000_000


def straight(stamps_s, turn_rate=0.0):
    """x = t, turning about z."""
    stamps_s = np.asarray(stamps_s, dtype=float)
    positions = np.stack([stamps_s, np.zeros_like(stamps_s), np.zeros_like(stamps_s)], axis=1)
    turned = Rotation.from_euler("z", turn_rate * stamps_s[:, None] + 0.1).as_quat()
    return Trajectory(np.round(stamps_s * 1e9).astype(np.int64), positions, turned)


def test_estimate_is_interpolated_in_position_and_rotation():
    pairs = associate(straight([0.0, 0.3, 0.4, 0.7], turn_rate=1.0), straight([0.05, 0.21, 0.33, 0.61], turn_rate=1.0))
    np.testing.assert_allclose(pairs.estimate.positions, pairs.reference.positions, atol=1e-12)
    assert ape(pairs)["rotation_deg"].max() < 1e-10


def test_nothing_is_extrapolated():
    pairs = associate(straight(np.arange(1.0, 2.01, 0.25)), straight(np.arange(0.0, 4.0, 0.1)))
    assert pairs.reference.stamps_ns.min() >= 1.0 * SECOND
    assert pairs.reference.stamps_ns.max() <= 2.0 * SECOND
    assert len(pairs) == 11


def test_a_gap_of_the_estimate_is_not_bridged_beyond_its_limit():
    estimate, reference = straight([0.0, 0.5, 2.0, 2.5]), straight(np.arange(0.0, 2.51, 0.1))
    narrow = associate(estimate, reference)
    assert not ((narrow.reference.stamps_ns > 0.5 * SECOND) & (narrow.reference.stamps_ns < 2.0 * SECOND)).any()
    assert len(narrow) == 12
    assert len(associate(estimate, reference, Association(max_gap_s=1.5))) == 26


def test_poses_at_the_ends_of_a_gap_are_compared():
    pairs = associate(straight([0.0, 10.0, 20.0]), straight([0.0, 5.0, 10.0, 20.0]))
    assert pairs.reference.stamps_ns.tolist() == [0, 10 * SECOND, 20 * SECOND]


def test_large_stamps_lose_no_nanosecond():
    shift = 1_694_161_404_123_456_789
    estimate, reference = straight(np.arange(0.0, 5.0, 0.1)), straight(np.arange(0.05, 4.0, 0.1))
    estimate = replace(estimate, stamps_ns=estimate.stamps_ns + shift)
    reference = replace(reference, stamps_ns=reference.stamps_ns + shift)
    assert ape(associate(estimate, reference))["translation_m"].max() < 1e-12


def test_offset_is_added_to_the_stamps_of_the_reference():
    reference = straight(np.arange(0.0, 5.0, 0.1))
    late = replace(reference, stamps_ns=reference.stamps_ns - 2 * SECOND)
    errors = ape(associate(reference, late, Association(reference_offset_s=2.0)))
    assert errors["translation_m"].max() < 1e-12
    assert ape(associate(reference, late))["east_m"].max() == pytest.approx(-2.0)


def test_lever_arm_moves_the_estimate_to_the_point_of_the_reference(wander):
    body = wander()
    arm = np.array([1.2, -0.5, 2.0])
    antenna = replace(body, positions=body.positions + Rotation.from_quat(body.quaternions).apply(arm))
    errors = ape(associate(body, antenna, Association(reference_lever_arm=tuple(arm))))
    assert errors["translation_m"].max() < 1e-12
    assert ape(associate(body, antenna))["translation_m"].min() == pytest.approx(np.linalg.norm(arm))


@pytest.mark.parametrize("quaternion", [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]])
def test_a_reference_without_orientation_is_recognised(wander, quaternion):
    reference = replace(wander(), quaternions=np.tile(quaternion, (400, 1)))
    pairs = associate(wander(), reference)
    assert not pairs.oriented
    assert set(ape(pairs)) == {"translation_m", "horizontal_m", "vertical_m", "east_m", "north_m", "up_m"}


def test_position_only_ignores_an_orientation(wander):
    assert associate(wander(), wander()).oriented
    assert not associate(wander(), wander(), Association(position_only=True)).oriented


def test_a_lever_arm_without_orientation_of_the_estimate_is_refused(wander):
    bare = replace(wander(), quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (400, 1)))
    with pytest.raises(ConfigError, match="lever arm"):
        associate(bare, wander(), Association(reference_lever_arm=(1.0, 0.0, 0.0)))


@pytest.mark.parametrize("method", ["estimate", "reference"])
def test_of_two_equally_near_poses_the_earlier_is_taken(method):
    dense, sparse = straight(np.arange(0.0, 5.0, 0.5)), straight([0.25, 1.25, 2.25])
    estimate, reference = (sparse, dense) if method == "estimate" else (dense, sparse)
    pairs = associate(estimate, reference, Association(method="nearest", max_difference_s=0.25))
    found = pairs.reference if method == "estimate" else pairs.estimate
    np.testing.assert_allclose(found.positions[:, 0], [0.0, 1.0, 2.0])


def test_tracks_without_common_time_are_refused_with_both_spans_and_the_remedy():
    with pytest.raises(
        RecordingError, match=r"no overlap.*0\.000 to 1\.000.*5\.000 to 6\.000 s; --offset shifts the reference$"
    ):
        associate(straight([0.0, 1.0]), straight([5.0, 6.0]), Association(names={"reference_offset_s": "--offset"}))
    with pytest.raises(RecordingError, match=r"6\.000 s$"):  # who cannot shift it is not told to
        associate(straight([0.0, 1.0]), straight([5.0, 6.0]))


def test_tracks_whose_poses_find_no_partners_are_refused_with_the_remedy():
    with pytest.raises(RecordingError, match=r"up to 0\.5 s; gap allows more$"):
        associate(straight([0.0, 10.0]), straight([4.0, 5.0]), Association(names={"max_gap_s": "gap"}))
    with pytest.raises(RecordingError, match=r"differ by 0\.01 s$"):
        associate(straight([0.0, 10.0]), straight([4.0, 5.0]), Association(method="nearest"))


@pytest.mark.parametrize("which", ["estimate", "reference"])
def test_a_single_pose_is_refused(which):
    tracks = {"estimate": straight([0.0, 1.0]), "reference": straight([0.0, 1.0])} | {which: straight([0.5])}
    with pytest.raises(RecordingError, match=f"the {which} has 1 pose, at least 2"):
        associate(**tracks)


def test_stamps_that_do_not_increase_are_refused_with_their_place():
    with pytest.raises(RecordingError, match=r"pose 3 at 1\.000000000 s follows 2\.000000000 s"):
        associate(straight([0.0, 2.0, 1.0]), straight([0.0, 1.0]))


def test_values_that_are_not_finite_are_refused_with_their_place():
    track = straight([0.0, 1.0, 2.0])
    track.positions[1, 2] = np.nan
    with pytest.raises(RecordingError, match="reference is not finite in pose 2"):
        associate(straight([0.0, 1.0]), track)


@pytest.mark.parametrize("wrong", [{"max_gap_s": -1.0}, {"reference_offset_s": float("nan")}])
def test_numbers_that_pair_nothing_are_refused(wrong):
    with pytest.raises(ConfigError, match="finite"):
        Association(**wrong)
