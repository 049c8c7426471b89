"""What there is to measure for the sensors of a machine: its motion, the sky over it, the earth, and chance."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from holdfast.geometry.earth import Geodetic, earth_rate_enu, gravity
from holdfast.messages import Array
from holdfast.sim.datasheets import Sheet
from holdfast.sim.readings import Readings, generator
from holdfast.sim.transport import sample_times_s

SKY_STEP_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class FrameMotion:
    """How one frame F moves in W at N times.

    Attributes:
        R_W_F: (N, 3, 3) attitude.
        p_W: (N, 3) position [m].
        v_W: (N, 3) velocity of the origin, expressed in W [m/s].
        a_W: (N, 3) acceleration of the origin, expressed in W [m/s^2].
        angular_velocity: (N, 3) of F against W, expressed in F [rad/s].
    """

    R_W_F: Array
    p_W: Array
    v_W: Array
    a_W: Array
    angular_velocity: Array

    def in_frame(self, vectors_W: Array) -> Array:
        """Return R_W_F^T v (N, 3) for vectors (3,) or (N, 3) in W."""
        vectors: Array = np.einsum("nji,nj->ni", self.R_W_F, np.broadcast_to(vectors_W, self.R_W_F.shape[:2]))
        return vectors


class Moving(Protocol):
    """A machine that moves."""

    def frame(self, name: str, times_s: Array) -> FrameMotion:
        """Return how a frame moves at true times (N,)."""

    def joint(self, times_s: Array) -> tuple[Array, Array]:
        """Return angle [rad] and rate [rad/s] of the turn joint, (N,) each."""


class Sky(Protocol):
    """A sky that objects hide in part."""

    def sky_view(self, p_W: Array) -> Array:
        """Return the fraction (N,) of the sky that is open over positions (N, 3) [m]."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A scenario with a seed, before anything is measured.

    Attributes:
        sheets: datasheets by the names of the sensors.
        imu_name: the IMU that is estimated.
        rotating: whether the IMUs feel the rotation of the earth.
    """

    sheets: Mapping[str, Sheet]
    imu_name: str
    seed: int
    duration_s: float
    datum: Geodetic
    rotating: bool
    motion: Moving
    sky: Sky
    _open_sky: dict[str, Array] = field(default_factory=dict, init=False)

    def generator(self, *names: str) -> np.random.Generator:
        """Return the random numbers of one purpose."""
        return generator(self.seed, *names)

    @property
    def gravity_m_s2(self) -> float:
        """Normal gravity at the datum, centrifugal part included."""
        return gravity(self.datum.latitude_deg, self.datum.altitude_m)

    @property
    def earth_rate_W(self) -> Array | None:
        """Angular velocity of the earth in W (3,) [rad/s], or None for an earth that stands still."""
        return earth_rate_enu(self.datum.latitude_deg) if self.rotating else None

    def times_s(self, name: str) -> Array:
        """Return when a sensor measures: the IMU that is estimated begins at zero, the others at times of their own."""
        sheet: Any = self.sheets[name]
        first_s = 0.0 if name == self.imu_name else sheet.first_s(name, self.sheets, self.generator)
        return sample_times_s(sheet.rate_hz, self.duration_s, first_s)

    def sampling(self, name: str) -> "Sampling":
        """Return a sensor at the times at which it measures, with random numbers of its own."""
        return Sampling(self, name, self.sheets[name], self.times_s(name), self.generator(name))

    def open_sky(self, frame: str, times_s: Array) -> Array:
        """Return the fraction (N,) of the sky that a frame sees at true times (N,), interpolated."""
        seconds = np.arange(0.0, self.duration_s + SKY_STEP_S, SKY_STEP_S)
        if frame not in self._open_sky:
            self._open_sky[frame] = self.sky.sky_view(self.motion.frame(frame, seconds).p_W)
        return np.interp(times_s, seconds, self._open_sky[frame])


@dataclass(frozen=True, slots=True, eq=False)
class Sampling:
    """One sensor at the times at which it measures.

    Attributes:
        sheet: its datasheet, of the class that belongs to its kind.
        times_s: (N,) true times of measurement since the start of the scenario.
        rng: random numbers of this sensor alone.
    """

    scene: Scene
    name: str
    sheet: Any
    times_s: Array
    rng: np.random.Generator

    @property
    def moving(self) -> FrameMotion:
        """How the sensor's frame moves, at these times."""
        return self.scene.motion.frame(self.sheet.frame, self.times_s)


Measure = Callable[[Sampling], Readings]
"""Makes the readings of a sensor."""
