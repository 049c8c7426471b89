"""People and trucks that move through a site, there and back along a path, with waits that the seed decides."""

from itertools import pairwise
from math import atan2, hypot

import numpy as np

from holdfast.messages import Array
from holdfast.sim.boxes import BoxMotion
from holdfast.sim.movers import Mover
from holdfast.sim.terrain import Terrain

# boxes of each kind: middle over the ground, then length, width, height [m]
SHAPES = {
    "person": (((0.0, 0.0, 0.88), (0.35, 0.55, 1.75)),),
    "truck": (((-1.0, 0.0, 1.6), (5.0, 2.5, 2.2)), ((2.6, 0.0, 1.6), (1.8, 2.4, 2.6))),
}


class Traffic:
    """All that moves on a site but the machine."""

    def __init__(
        self, movers: tuple[Mover, ...], terrain: Terrain, duration_s: float, seeds: list[np.random.Generator]
    ):
        self._terrain = terrain
        self._movers = movers
        self._timetables = [_timetable(mover, duration_s, rng) for mover, rng in zip(movers, seeds, strict=True)]

    def at(self, times_s: Array) -> list[BoxMotion]:
        """Return the boxes in W at true times (N,)."""
        boxes = []
        for mover, (stops_s, stops_m, yaws) in zip(self._movers, self._timetables, strict=True):
            east, north = (np.interp(times_s, stops_s, axis) for axis in stops_m.T)
            yaw = yaws[np.clip(np.searchsorted(stops_s, times_s, side="right") - 1, 0, len(yaws) - 1)]
            c, s, zero, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
            R = np.stack([np.stack(row, -1) for row in ((c, -s, zero), (s, c, zero), (zero, zero, one))], axis=1)
            feet = np.column_stack([east, north, self._terrain.height(east, north)])
            shape = SHAPES.get(mover.kind) or (((0.0, 0.0, mover.size_m[2] / 2.0), mover.size_m),)
            boxes += [
                BoxMotion(R, feet + np.einsum("nij,j->ni", R, np.array(middle)), np.array(size) / 2.0)
                for middle, size in shape
            ]
        return boxes


def _timetable(mover: Mover, duration_s: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return times (K,) [s], places (K, 2) [m] and yaws (K,) [rad] from each time on; a truck backs up to go back."""
    yaws = [atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(mover.path_m)]
    there = list(zip(mover.path_m[1:], yaws, strict=True))
    back = list(zip(mover.path_m[-2::-1], yaws[::-1], strict=True))
    at_s, place = mover.start_s, mover.path_m[0]
    rows = [(at_s, place, yaws[0])]
    while at_s < duration_s:
        for target, yaw in (*there, *back):
            at_s += float(rng.uniform(0.0, mover.wait_s)) + 1e-3
            rows.append((at_s, place, yaw))
            at_s += hypot(target[0] - place[0], target[1] - place[1]) / mover.speed_m_s
            place = target
            rows.append((at_s, place, yaw))
    times_s, places, headings = zip(*rows, strict=True)
    return np.array(times_s), np.array(places), np.array(headings)
