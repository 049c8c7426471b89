"""A sensor whose motion is given, sampled without a scenario."""

from dataclasses import dataclass

import numpy as np

from holdfast.geometry.earth import Geodetic
from holdfast.sim.scene import FrameMotion, Sampling, Scene
from holdfast.sim.sensors import KINDS

DATUM = Geodetic(47.4, 8.0, 450.0)


@dataclass(frozen=True)
class Held:
    """A machine of which every frame moves alike, whenever it is asked."""

    moving: FrameMotion | None
    joint_rad: np.ndarray | None = None

    def frame(self, _name, _times_s):
        return self.moving

    def joint(self, _times_s):
        return self.joint_rad, np.zeros_like(self.joint_rad)


@dataclass(frozen=True, eq=False)
class EvenScene(Scene):
    """A scene in which every frame sees the same part of the sky all the time."""

    part: float = 1.0

    def open_sky(self, _frame, times_s):
        return np.full(len(times_s), self.part)


def sampled(sheet, moving, times_s, rng, *, joint_rad=None, earth_rotation=False, open_sky=1.0):
    """Return the readings of a sensor whose frame has this motion at these times (N,)."""
    machine = Held(moving, joint_rad)
    of_machine = {"one": sheet}, "one", 0, float(times_s[-1]), DATUM, earth_rotation, machine, machine
    scene = EvenScene(*of_machine, part=open_sky)
    return KINDS[sheet.kind].measure(Sampling(scene, "one", sheet, times_s, rng))
