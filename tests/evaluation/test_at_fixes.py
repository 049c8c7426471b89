"""The track beside the fixes, the surprise of each fix, and how far updates move what was published."""

import numpy as np
import pytest

from holdfast.errors import RecordingError
from holdfast.evaluation.at_fixes import at_fixes, nis
from holdfast.evaluation.corrections import corrections
from holdfast.evaluation.evidence import Chassis, Fixes, Published, Truth
from holdfast.evaluation.smoothness import Inertial
from holdfast.evaluation.states import States
from holdfast.state import Trajectory

ARM = np.array([0.0, 2.0, 1.0])
QUARTER_TURN = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])  # 90 deg about z
PERIOD_NS = 10_000_000


def scene(position_sigma=0.1, attitude_sigma=0.0, fix_sigma=0.05, count=6000, seed=0):
    """A machine turned by 90 deg that stands, published with errors of what its covariance says."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(1, count + 1) * PERIOD_NS
    p = position_sigma * rng.standard_normal((count, 3))
    track = Trajectory(stamps, p, np.tile(QUARTER_TURN, (count, 1)))
    P = np.eye(9) * 1e-12
    P[:3, :3] = np.eye(3) * attitude_sigma**2
    P[3:6, 3:6] = np.eye(3) * position_sigma**2
    still = Inertial(np.zeros((count, 3)), np.zeros((count, 3)), np.ones(count, dtype=bool), np.zeros((count, 3)))
    states = States(track, np.zeros((count, 3)))
    published = Published(states, states, np.tile(P, (count, 1, 1)), still, np.ones(count, dtype=bool))
    error = fix_sigma * rng.standard_normal((count, 3))
    antenna = np.array([-2.0, 0.0, 1.0])  # the arm, turned
    good = np.ones(count, dtype=bool)
    fixes = Fixes(stamps, antenna + error, error, good, ~good, ARM)
    truth = Truth(0, states, [fixes], None, None, Chassis(track, np.zeros(count)), ~good)
    return published, truth, p, error


def test_a_miss_is_the_published_antenna_minus_the_fix():
    published, truth, p, error = scene()
    found = at_fixes(published.world.poses, truth, np.ones(6000, dtype=bool))
    np.testing.assert_allclose(found.residuals, p - error, atol=1e-12)
    np.testing.assert_array_equal(found.fix_errors, error)


def test_only_good_times_and_good_fixes_count():
    published, truth, _, _ = scene(count=100)
    good = np.ones(100, dtype=bool)
    good[50:] = False
    assert at_fixes(published.world.poses, truth, good).stamps_ns.max() == 50 * PERIOD_NS
    assert len(at_fixes(published.world.poses, truth, ~np.ones(100, dtype=bool)).stamps_ns) == 0


def test_nis_is_three_on_the_mean_for_an_honest_estimate():
    published, truth, _, _ = scene()
    values = nis(published, at_fixes(published.world.poses, truth, np.ones(6000, dtype=bool)))
    # chi-square of 3 degrees has variance 6; five sigma of the mean of 6000
    assert abs(values.mean() - 3.0) < 5.0 * np.sqrt(6.0 / 6000)


def test_uncertain_attitude_explains_residuals_across_the_arm_alone():
    published, truth, _, _ = scene(attitude_sigma=0.5)
    certain, _, _, _ = scene()
    found = at_fixes(published.world.poses, truth, np.ones(6000, dtype=bool))
    assert nis(published, found).mean() < 0.6 * nis(certain, found).mean()
    along = truth.antennas[0].positions[0] - truth.antennas[0].errors[0]  # the direction of the arm in W
    found.residuals[:] = along / np.linalg.norm(along) * 0.2
    # 6000 errors of the fixes are not quite alike in all directions
    np.testing.assert_allclose(nis(published, found), nis(certain, found), rtol=1e-3)


def test_a_correction_is_the_distance_of_the_new_state_from_the_published_one():
    stamps = np.arange(10) * PERIOD_NS
    moving = np.outer(np.arange(10.0), [0.01, 0.0, 0.0])
    published = Trajectory(stamps, moving, np.tile(QUARTER_TURN, (10, 1)))
    between = stamps[:-1] + PERIOD_NS // 2
    optimised = Trajectory(between, moving[:-1] + np.array([0.005, 0.003, 0.004]), np.tile(QUARTER_TURN, (9, 1)))
    at, distances = corrections(published, optimised)
    np.testing.assert_array_equal(at, between)
    np.testing.assert_allclose(distances, 0.005, atol=1e-12)


def test_states_that_were_never_published_have_no_correction():
    track = Trajectory(np.arange(10) * PERIOD_NS, np.zeros((10, 3)), np.tile(QUARTER_TURN, (10, 1)))
    later = Trajectory(track.stamps_ns + 10**9, track.positions, track.quaternions)
    with pytest.raises(RecordingError, match="no overlap"):
        corrections(track, later)
