"""What is cut out of a sweep: the machine, learnt from moving, and nothing of the world."""

import gtsam
import numpy as np
import pytest
from yard import ELEVATIONS_DEG, T_W_L, slow_rad, standing, sweep

from holdfast.lidar_odometry.machine_mask import MachineMask
from holdfast.lidar_odometry.masked import Masked, Masking, boxes_of
from holdfast.lidar_odometry.registration import Registered, Registration

rng = np.random.default_rng(3)
HOOD = rng.uniform([-2.6, -0.7, -1.2], [-1.6, 0.7, -0.8], (400, 3))
TURN = 60  # sweeps at 0.2 rad/s: 137 deg


def boom(number):
    """Points on an arm in front of the lidar that goes up and down."""
    along, pitch = rng.uniform(1.5, 5.0, 300), 0.3 * np.sin(number * 0.5)
    return np.column_stack([along * np.cos(pitch), rng.uniform(-1.0, -0.7, 300), along * np.sin(pitch) - 0.8])


def hidden(points):
    """Rays that the hood takes from the world."""
    rays, towards = (part / np.linalg.norm(part, axis=1, keepdims=True) for part in (points, HOOD))
    return (rays @ towards.T).max(axis=1) > 0.9995


def world_of(number, elevations_deg=ELEVATIONS_DEG):
    """Points of the yard in one sweep, as if the cabin stood still while it lasts."""
    return sweep(
        number, rng, lambda t: np.full_like(t, slow_rad(number * 0.2), dtype=float), elevations_deg=elevations_deg
    ).points


def taught_by(elevations_deg, of_machine=lambda points: points):
    """A mask after a quarter of a turn, and the yard as it was then without the machine."""
    mask = MachineMask()
    for number in range(TURN):
        world = world_of(number, elevations_deg)
        machine = of_machine(np.concatenate([HOOD, boom(number)]))
        mask.learn(np.concatenate([world[~hidden(world)], machine]), T_W_L(number * 0.2, slow_rad))
    return mask, world


@pytest.fixture(scope="module")
def taught():
    return taught_by(ELEVATIONS_DEG)


def test_what_turns_with_the_lidar_is_the_machine(taught):
    assert taught[0].covers(HOOD).mean() > 0.9


@pytest.mark.parametrize("rings", [18, 9])
def test_a_lidar_with_few_rings_learns_the_machine_and_keeps_the_world(rings):
    elevations_deg = np.linspace(25.0, -45.0, rings)

    def on_rings(points):
        level, ring = np.hypot(points[:, 0], points[:, 1]), np.radians(elevations_deg)
        nearest = ring[np.abs(np.arctan2(points[:, 2], level)[:, None] - ring).argmin(axis=1)]
        return np.column_stack([points[:, :2], level * np.tan(nearest)])

    mask, world = taught_by(elevations_deg, on_rings)
    assert mask.covers(on_rings(HOOD)).mean() > 0.9
    assert mask.covers(world).mean() < 0.01


def test_all_that_the_arm_sweeps_is_the_machine(taught):
    swept = np.concatenate([boom(number + 0.5) for number in range(12)])
    assert taught[0].covers(swept).mean() > 0.7


def test_the_ground_and_the_yard_are_not_cut_though_the_ground_looks_the_same_from_everywhere(taught):
    mask, world = taught
    assert mask.covers(world).mean() < 0.01


def test_who_stands_still_learns_nothing():
    mask = MachineMask()
    for number in range(30):
        points = np.concatenate([sweep(number, rng, standing, times=False).points, HOOD, boom(number)])
        mask.learn(points, T_W_L(0.0, standing))
    assert not mask.covers(np.concatenate([HOOD, boom(1)])).any()


def test_a_person_who_walks_along_is_not_the_machine():
    mask = MachineMask()
    for number in range(TURN):
        at_s = number * 0.2
        world = world_of(number)
        stands = np.array([5.0 - 0.25 * number, 4.0, 0.9])
        person = T_W_L(at_s, slow_rad).transformTo(stands) + rng.uniform(-0.3, 0.3, (60, 3))
        mask.learn(np.concatenate([world, person]), T_W_L(at_s, slow_rad))
    assert mask.covers(world).mean() < 0.01


def test_boxes_are_cut_from_the_first_sweep_on():
    mask = MachineMask(boxes_of([(-1.6, 0.7, -0.8, -2.6, -0.7, -1.2)]), learning=False)
    assert mask.covers(HOOD).all()
    assert not mask.covers(HOOD + np.array([0.0, 0.0, 1.0])).any()


class _Counting(Registration):
    """A registration that only notes what it got."""

    def __init__(self):
        self.sizes = []

    def register(self, swept):
        self.sizes.append(len(swept.points))
        return Registered(swept.stamp_ns, np.eye(4))


def test_a_registration_gets_what_is_left_and_the_share_that_is_cut_is_reported():
    inner, swept = _Counting(), sweep(0, rng)
    half = boxes_of([(0.0, -99.0, -99.0, 99.0, 99.0, 99.0)])
    registered = Masked(inner, Masking(half, learning=False)).register(swept)
    ahead = (swept.points[:, 0] >= 0.0).mean()
    assert registered.cut == pytest.approx(ahead)
    assert inner.sizes == [round((1 - ahead) * len(swept.points))]


def test_a_mask_over_everything_cuts_nothing():
    inner, swept = _Counting(), sweep(0, rng)
    everything = boxes_of([(-99.0, -99.0, -99.0, 99.0, 99.0, 99.0)])
    assert Masked(inner, Masking(everything, learning=False)).register(swept).cut == 0.0
    assert inner.sizes == [len(swept.points)]
    assert gtsam.Pose3().equals(gtsam.Pose3(Masked(inner, Masking()).register(swept).T_L0_L), 1e-9)


def test_a_machine_that_stands_is_learnt_from_the_points_as_they_are_whatever_guides_the_odometry(monkeypatch):
    learnt = []
    monkeypatch.setattr(MachineMask, "is_due", lambda *_: True)
    monkeypatch.setattr(MachineMask, "learn", lambda _mask, points, _pose: learnt.append(points))
    masked, sweeps = Masked(_Counting(), Masking()), [sweep(k, rng, standing, gyroscope=True) for k in range(2)]
    for swept in sweeps:
        masked.register(swept)
    masked.finish()
    np.testing.assert_allclose(learnt[1], sweeps[1].points, atol=1e-9)
