"""A walled yard where a lorry stands for the first tenth of the time, seen by a lidar on a machine that drives."""

import numpy as np

from holdfast.lidar_odometry.sweep import Sweep
from holdfast.state import Trajectory

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 200_000_000
YARD_M = np.array([12.0, 8.0, 3.0])  # half of its sides
LORRY_M = np.array([[4.0, -1.5, -3.0], [7.0, 1.5, -1.0]])  # two corners
MARGIN_M = 0.01
T_I_L = np.array([[0.0, -1.0, 0.0, 0.4], [1.0, 0.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.6], [0.0, 0.0, 0.0, 1.0]])


def drive(seconds: float) -> Trajectory:
    """East at 0.2 m/s while the machine turns at 0.5 rad/s."""
    stamps = START_NS + np.arange(0, round(seconds * 1e9) + 1, 10_000_000)
    positions, yaw = motion((stamps - START_NS) * 1e-9)
    zero = np.zeros(len(yaw))
    quaternions = np.column_stack([zero, zero, np.sin(yaw / 2.0), np.cos(yaw / 2.0)])
    return Trajectory(stamps, positions, quaternions)


def motion(times_s):
    zero = np.zeros(len(times_s))
    return np.column_stack([0.2 * times_s - 3.0, zero, zero]), 0.5 * times_s


def sweeps(count: int, with_lorry: int, rays: int = 4000):
    """Sweeps at 5 Hz, of which the first ones see the lorry; intensity is the range."""
    rng = np.random.default_rng(1)
    for k in range(count):
        offsets_s = np.sort(rng.random(rays)) * PERIOD_NS * 1e-9
        positions, yaw = motion(k * PERIOD_NS * 1e-9 + offsets_s)
        R = np.zeros((rays, 3, 3))
        R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1] = np.cos(yaw), -np.sin(yaw), np.sin(yaw), np.cos(yaw)
        R[:, 2, 2] = 1.0
        origins = positions + R @ T_I_L[:3, 3]
        directions = rng.standard_normal((rays, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        reach = np.min((YARD_M * np.sign(directions) - origins) / directions, axis=1)
        if k < with_lorry:
            sides = (LORRY_M[:, None] - origins) / directions
            enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
            reach = np.where((enter < leave) & (enter > 0.0), np.minimum(reach, enter), reach)
        in_lidar = np.einsum("nji,nj->ni", R @ T_I_L[:3, :3], directions * reach[:, None])
        yield Sweep(START_NS + k * PERIOD_NS, "lidar", in_lidar, offsets_s, intensities=reach)


def off_the_walls(points):
    """Distance (N,) of points to the yard [m]."""
    return np.abs(YARD_M - np.abs(points)).min(axis=1)


def on_lorry(points):
    """Whether points (N,) are on the lorry, above the ground."""
    low, high = LORRY_M - np.array([[MARGIN_M], [-MARGIN_M]])
    return ((points >= low) & (points <= high)).all(axis=1) & (points[:, 2] > low[2] + 0.3)


def high_on_lorry(points):
    """Whether points (N,) are on its upper half."""
    return on_lorry(points) & (points[:, 2] > LORRY_M[:, 2].mean())
