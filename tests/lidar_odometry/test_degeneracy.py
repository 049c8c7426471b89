"""Which directions of motion a scan holds, and what is claimed of the others."""

import numpy as np
import pytest
import small_gicp

from holdfast.lidar_odometry.degeneracy import WEAK, Degeneracy, Observability
from holdfast.lidar_odometry.planes import Planes
from holdfast.lidar_odometry.small_gicp import SmallGicp
from holdfast.lidar_odometry.sweep import Sweep

STILL = np.eye(4)
INFORMED = np.diag(np.repeat([1e-6, 1e-4], 3))  # covariance of a registration
WALKED = np.array([0.0, 0.0, 0.0, 0.4, 0.0, 0.0])


def plane(origin, first, second, rng, count=3000, *, rough_m=0.02):
    """Points on a parallelogram, a little rough."""
    across = np.cross(first, second) / np.linalg.norm(np.cross(first, second))
    places = rng.uniform(-1, 1, (count, 2)) @ np.array([first, second]) + origin
    return places + rng.normal(0, rough_m, (count, 1)) * across


def tunnel(rng):
    """Along x."""
    floor = plane([0, 0, -2], [20, 0, 0], [0, 3, 0], rng)
    walls = [plane([0, y, 0.5], [20, 0, 0], [0, 0, 2.5], rng) for y in (-3.0, 3.0)]
    return np.concatenate([floor, *walls])


def field(rng):
    return plane([0, 0, -3], [20, 0, 0], [0, 20, 0], rng, 8000)


def room(rng):
    ends = [plane([x, 0, 0.5], [0, 3, 0], [0, 0, 2.5], rng, 1000) for x in (-20.0, 20.0)]
    return np.concatenate([tunnel(rng), *ends])


NO_DOUBT = np.zeros(6)


def look(points, motion=STILL, by=None, pattern_repeats=True):
    return (by or Degeneracy()).look(Planes.around(small_gicp.PointCloud(points), 1), motion, pattern_repeats)


def pillars_and_rings(rng):
    """Bare ground as 16 rings see it from 3 m above, 2 deg apart, and six pillars that they see well."""
    radii = 3.0 / np.tan(np.radians(np.arange(3, 16, 2)))
    around = [np.arange(0.0, 2.0 * np.pi, 0.35 / radius) for radius in radii]
    rings = [
        np.column_stack([radius * np.cos(at), radius * np.sin(at), np.full_like(at, -3.0)])
        for radius, at in zip(radii, around, strict=True)
    ]
    at, up = (one.ravel() for one in np.meshgrid(np.arange(0.0, 2.0 * np.pi, 0.45), np.arange(-3.0, 1.0, 0.3)))
    pillars = [np.column_stack([13.0 * np.cos(k) + np.cos(at), 13.0 * np.sin(k) + np.sin(at), up]) for k in range(6)]
    points = np.concatenate([*rings, *pillars])
    return points + rng.normal(0.0, 0.02, points.shape)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_small_and_seen_well_holds_a_lidar_with_few_rings(seed):
    assert look(pillars_and_rings(np.random.default_rng(seed))).unheld_axes.shape == (3, 0)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("scene", "unheld"), [(tunnel, 1), (field, 3), (room, 0)])
def test_a_tunnel_leaves_one_direction_free_a_field_three_and_a_room_none(scene, unheld, seed):
    assert look(scene(np.random.default_rng(seed))).unheld == unheld


def test_along_a_tunnel_the_motion_is_not_measured_and_across_it_is():
    found = look(tunnel(np.random.default_rng(1)))
    moved = np.array([0.01, -0.02, 0.03, 0.5, 0.2, -0.1])
    part = found.held_part(moved, np.eye(6), NO_DOUBT)
    np.testing.assert_allclose(part[[0, 1, 2, 4, 5]], moved[[0, 1, 2, 4, 5]], atol=0.02)
    assert abs(part[3]) < 0.02


def test_over_a_field_height_and_tilt_are_measured_only():
    found = look(field(np.random.default_rng(1)))
    moved = np.array([0.01, -0.02, 0.03, 0.5, 0.2, -0.1])
    part = found.held_part(moved, np.eye(6), NO_DOUBT)
    np.testing.assert_allclose(part[[0, 1, 5]], moved[[0, 1, 5]], atol=2e-3)
    np.testing.assert_allclose(
        part[[2, 3, 4]], 0.0, atol=0.09
    )  # to tilt about the ground shifts the lidar by 3 m times


def test_the_free_direction_has_the_covariance_of_the_guess_and_the_others_that_of_the_registration():
    found = look(tunnel(np.random.default_rng(2)))
    guess = np.diag(np.repeat([1e-2, 4.0], 3))
    sigmas = np.sqrt(np.diag(found.covariance(INFORMED, guess, NO_DOUBT)))
    assert sigmas[3] == pytest.approx(2.0, rel=0.05)
    assert (sigmas[4:] < 0.1).all()
    assert sigmas[2] < 5e-3


def test_where_all_is_held_the_registration_claims_for_itself():
    found = look(room(np.random.default_rng(3)))
    np.testing.assert_array_equal(found.covariance(INFORMED, np.eye(6), found.doubted(WALKED)), INFORMED)


def test_what_a_weak_direction_corrects_is_believed_as_much_as_the_guess_is_doubted_more():
    weak = Observability(np.eye(6), np.eye(6), np.array([99.0, 99.0, 99.0, WEAK / 2.0, 99.0, 99.0]))
    doubted = weak.doubted(WALKED)
    share = 1.0 / (1.0 + WEAK / 2.0) - 1.0 / (1.0 + WEAK)
    np.testing.assert_allclose(doubted, [0.0, 0.0, 0.0, share * abs(WALKED[3]), 0.0, 0.0], atol=1e-12)
    correction = np.full(6, 0.01)
    surer, equal = np.diag(np.full(6, 1e-8)), np.diag(np.full(6, doubted[3] ** 2))
    np.testing.assert_allclose(weak.held_part(correction, surer, doubted)[3], 0.0, atol=1e-4)
    np.testing.assert_allclose(weak.held_part(correction, equal, doubted), [0.01] * 3 + [0.005] + [0.01] * 2)
    assert weak.joined(doubted, equal)[3] == pytest.approx(doubted[3] / np.sqrt(2.0))


def test_the_less_a_direction_is_held_the_more_of_the_motion_is_in_doubt_without_a_step():
    def share(ratio, mixed=1.0):
        found = Observability(np.eye(6), np.eye(6), np.array([99.0, 99.0, 99.0, ratio, 99.0, 99.0]), mixed=mixed)
        return found.doubted(WALKED)[3] / abs(WALKED[3])

    shares = [share(ratio) for ratio in np.linspace(-1.0, WEAK + 1.0, 200)]
    assert (np.diff(shares) <= 0.0).all()
    assert np.abs(np.diff(shares)).max() < 0.08
    assert shares[0] == pytest.approx(1.0 - 1.0 / (1.0 + WEAK))
    assert shares[-1] == 0.0
    assert share(5.0, mixed=0.1) > 2.0 * share(5.0)  # what patterns that do not repeat pull by, chance decides


def test_a_turn_that_is_not_told_from_a_shift_is_left_to_a_gyroscope_that_knows_it():
    """A wall 20 m ahead holds the distance to it; to turn and to shift move what little is on it alike."""
    turned_and_shifted = np.array([0.0, 0.0, 1.0, 0.0, 20.0, 0.0])
    apart = np.array([0.0, 0.0, 20.0, 0.0, -1.0, 0.0])
    duals = np.eye(6)
    duals[:, 2] = turned_and_shifted / np.linalg.norm(turned_and_shifted)
    duals[:, 4] = apart / np.linalg.norm(apart)
    found = Observability(np.linalg.inv(duals.T), duals, np.array([99.0, 99.0, 99.0, 99.0, 0.0, 99.0]))
    guess = np.diag(np.repeat([1e-8, 1e-2], 3))  # 0.1 mrad and 0.1 m
    part = found.held_part(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]), guess, NO_DOUBT)
    assert abs(part[2]) < 1e-6
    assert turned_and_shifted @ part == pytest.approx(0.02)
    blind = found.held_part(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]), 1e6 * np.eye(6), NO_DOUBT)
    assert np.linalg.norm(blind) < 0.02  # without a gyroscope, neither turns far nor shifts far


def test_only_directions_that_move_the_lidar_leave_its_velocity_unmeasured():
    ratios = np.array([0.0, 99.0, 99.0, 0.0, 99.0, 99.0])
    np.testing.assert_allclose(np.abs(Observability(np.eye(6), np.eye(6), ratios).unheld_axes), [[1.0], [0.0], [0.0]])


def test_an_end_that_the_sweep_before_did_not_see_holds_nothing_yet():
    rng = np.random.default_rng(4)
    one = Degeneracy()
    look(tunnel(rng), by=one)
    moved = STILL.copy()
    end = plane([24, 0, 0.5], [0, 3, 0], [0, 0, 2.5], rng, 1000)
    assert look(np.concatenate([tunnel(rng), end]), moved, one).unheld == 1
    assert look(np.concatenate([tunnel(rng), end]), moved, one).unheld == 0


def test_a_sweep_that_meets_nothing_of_the_one_before_holds_nothing():
    rng, one = np.random.default_rng(7), Degeneracy()
    look(room(rng), by=one)
    elsewhere = STILL.copy()
    elsewhere[0, 3] = 200.0
    assert look(room(rng), elsewhere, one).unheld == 6


def test_a_pattern_that_no_sweep_repeats_pulls_less():
    """A wall holds the motion across it; a post beside it, by a few points, the motion along it."""
    rng = np.random.default_rng(8)
    ground = plane([0, 0, -3], [20, 0, 0], [0, 20, 0], rng, 8000, rough_m=0.002)
    wall = plane([10, 0, 0], [0, 8, 0], [0, 0, 2.5], rng, 3000, rough_m=0.002)
    post = plane([8, 2.6, -1], [0.5, 0, 0], [0, 0, 1.0], rng, 20, rough_m=0.002)
    points = np.concatenate([ground, wall, post])
    assert look(points).unheld == 1
    assert look(points, pattern_repeats=False).unheld == 0
    assert look(tunnel(rng), pattern_repeats=False).unheld == 1


@pytest.mark.parametrize("interval_s", [0.1, 0.2, 0.5])
def test_independent_claims_of_the_guess_add_up_to_what_an_unseen_braking_does(interval_s):
    rng = np.random.default_rng(5)
    one, found, summed = Degeneracy(), look(tunnel(rng)), 0.0
    for _ in range(round(5.0 / interval_s)):
        summed += one.guess_covariance(interval_s, found, True)[3, 3]
    assert np.sqrt(summed) == pytest.approx(0.5 * 1.0 * 5.0**2 + 0.05 * 5.0)
    one.guess_covariance(interval_s, look(room(rng)), True)
    assert np.sqrt(one.guess_covariance(0.2, found, True)[3, 3]) < 0.05  # held once, it begins again


def test_a_gyroscope_guesses_the_rotation_better():
    found = look(field(np.random.default_rng(6)))
    with_one, without = (Degeneracy().guess_covariance(0.2, found, has) for has in (True, False))
    assert with_one[2, 2] < 0.01 * without[2, 2]


def test_along_a_tunnel_nothing_is_said_to_have_moved():
    """The poses are guessed there: the end wall that will correct them would be where nothing was."""
    odometry, rng = SmallGicp(1), np.random.default_rng(4)
    for number in range(5):
        odometry.register(Sweep(10**18 + number * 400_000_000, "lidar", tunnel(rng), None))
    odometry.finish()
    assert len(odometry._map._free._views) == 1
