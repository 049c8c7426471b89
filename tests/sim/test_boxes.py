"""Boxes that move before the lidar: the machine's arm, people and trucks."""

import numpy as np
import pytest

from holdfast.errors import ConfigError
from holdfast.sim.arm import Parts
from holdfast.sim.boxes import BoxMotion, distances
from holdfast.sim.movers import Arm, Mover, Part
from holdfast.sim.readings import generator
from holdfast.sim.scans import Scanner
from holdfast.sim.scenario import load_scenario
from holdfast.sim.simulation import simulate
from holdfast.sim.traffic import Traffic

COLUMNS = 64
AZIMUTH = np.pi - 2.0 * np.pi * np.arange(COLUMNS) / COLUMNS
RAYS = np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH), np.zeros(COLUMNS)], axis=1)[:, None]
STILL = np.tile(np.eye(3), (COLUMNS, 1, 1))
AT_ZERO = np.zeros((COLUMNS, 3))
FORWARD = COLUMNS // 2  # the column that looks along x


def box(p, half=(0.5, 1.0, 1.0), R=STILL):
    return BoxMotion(R, np.broadcast_to(np.array(p, dtype=float), (COLUMNS, 3)), np.array(half))


@pytest.fixture(scope="module")
def happened():
    return simulate(load_scenario("arm-and-traffic", {"duration_s": 40.0}), 1)


def test_a_ray_ends_at_the_near_face_and_others_go_on():
    found = distances([box((4.0, 0.0, 0.0))], RAYS, STILL, AT_ZERO)[:, 0]
    assert found[FORWARD] == pytest.approx(3.5)
    assert np.isinf(found[0])
    seen = np.abs(AZIMUTH) < np.arctan2(1.0, 3.5)
    np.testing.assert_array_equal(np.isfinite(found), seen)


def test_the_nearer_of_two_boxes_is_seen_and_none_from_inside():
    both = [box((6.0, 0.0, 0.0)), box((4.0, 0.0, 0.0))]
    assert distances(both, RAYS, STILL, AT_ZERO)[FORWARD, 0] == pytest.approx(3.5)
    assert np.isinf(distances([box((0.0, 0.0, 0.0))], RAYS, STILL, AT_ZERO)).all()


def test_a_box_is_where_it_is_when_the_ray_is_measured():
    p = np.column_stack([np.linspace(3.0, 5.0, COLUMNS), np.zeros((COLUMNS, 2))])
    found = distances([BoxMotion(STILL, p, np.array([0.5, 1.0, 1.0]))], RAYS, STILL, AT_ZERO)
    assert found[FORWARD, 0] == pytest.approx(p[FORWARD, 0] - 0.5)


def test_turned_box_and_turned_lidar_see_each_other_alike():
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = np.tile(turn, (COLUMNS, 1, 1))
    ahead = distances([box((4.0, 0.0, 0.0))], RAYS, STILL, AT_ZERO)
    found = distances([box((0.0, 4.0, 0.0), R=turned)], RAYS, turned, AT_ZERO)
    np.testing.assert_allclose(found, ahead)


def test_the_arm_hangs_together_and_turns_with_the_cabin(happened):
    times_s = np.arange(0.0, 40.0, 0.5)
    boom, stick, bucket = Parts((), Arm(), happened.motion).at(times_s)
    for near, far in ((boom, stick), (stick, bucket)):
        end = near.p_W + near.half_size[0] * near.R_W_X[:, :, 0]
        begin = far.p_W - far.half_size[0] * far.R_W_X[:, :, 0]
        np.testing.assert_allclose(end, begin, atol=1e-9)
    cabin = happened.motion.frame("cabin", times_s)
    np.testing.assert_allclose(np.sum(boom.R_W_X[:, :, 1] * cabin.R_W_F[:, :, 1], axis=1), 1.0)


def test_the_bucket_is_in_the_trench_while_the_machine_digs_and_high_while_it_slews(happened):
    times_s = np.arange(0.0, 40.0, 0.1)
    work = happened.motion.work(times_s)
    bucket = Parts((), Arm(), happened.motion).at(times_s)[-1]
    height = bucket.p_W[:, 2] - happened.motion.frame("base_link", times_s).p_W[:, 2]
    assert np.median(height[work > 0.95]) < 0.0
    assert np.median(height[np.abs(work - 0.4) < 0.02]) > 1.0


def test_parts_stay_where_they_are_on_the_machine(happened):
    times_s = np.arange(0.0, 40.0, 0.5)
    part = Part(frame="base_link", center_m=(1.0, 2.0, 0.5), size_m=(1.0, 1.0, 1.0))
    (found,) = Parts((part,), None, happened.motion).at(times_s)
    base = happened.motion.frame("base_link", times_s)
    local = np.einsum("nji,nj->ni", base.R_W_F, found.p_W - base.p_W)
    np.testing.assert_allclose(local, np.tile([1.0, 2.0, 0.5], (len(times_s), 1)), atol=1e-9)


def walkers(seed, happened):
    mover = Mover(kind="person", path_m=((0.0, 0.0), (3.0, 4.0)), speed_m_s=1.25, wait_s=2.0)
    return Traffic((mover,), happened.site.terrain, 60.0, [generator(seed, "traffic", "0")])


def test_a_person_walks_the_path_no_faster_than_given_and_stands_on_the_ground(happened):
    times_s = np.arange(0.0, 60.0, 0.1)
    (person,) = walkers(1, happened).at(times_s)
    speed = np.linalg.norm(np.diff(person.p_W[:, :2], axis=0), axis=1) / 0.1
    assert speed.max() == pytest.approx(1.25)
    assert (speed < 1e-9).any()
    np.testing.assert_allclose(4.0 * person.p_W[:, 0] - 3.0 * person.p_W[:, 1], 0.0, atol=1e-9)
    ground = happened.site.terrain.height(person.p_W[:, 0], person.p_W[:, 1])
    np.testing.assert_allclose(person.p_W[:, 2] - ground, 0.88)


def test_equal_seeds_give_equal_walks_and_other_seeds_do_not(happened):
    times_s = np.arange(0.0, 60.0, 0.5)
    first, again, other = (walkers(seed, happened).at(times_s)[0].p_W for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1


def test_what_moves_hides_the_site_and_changes_no_other_return(happened):
    sheet = happened.scenario.sensors["scanner"].model_copy(update={"channels": 32, "columns": 128})
    scanner = Scanner(sheet, happened.site.mesh())
    times_s = scanner.column_times_s(20.0)
    moving = happened.motion.frame(sheet.frame, times_s)
    boxes = [one for group in happened.moving_boxes() for one in group.at(times_s)]
    with_them, without = (
        scanner.scan(0, moving.R_W_F, moving.p_W, generator(1, "scan", "0"), seen) for seen in (boxes, [])
    )
    assert 0.1 < with_them.moving.mean() < 0.6
    assert not without.moving.any()
    site = {(t, ring): tuple(p) for t, ring, p in zip(without.offset_ns, without.ring, without.points, strict=True)}
    rest = ~with_them.moving
    rows = zip(with_them.offset_ns[rest], with_them.ring[rest], with_them.points[rest], strict=True)
    assert all(site[t, ring] == tuple(p) for t, ring, p in rows)


def test_a_part_of_no_frame_of_the_machine_is_refused():
    part = {"frame": "bonnet", "center_m": [0, 0, 0], "size_m": [1, 1, 1]}
    with pytest.raises(ConfigError, match="body: frame of entry 1 must be base_link or cabin"):
        load_scenario("quick", {"body": [part]})
