"""What the estimator has checked, collected while it runs: samples, measurements, and its own estimate as a start."""

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterator
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from holdfast.config.model import Config
from holdfast.estimator.imu_path import Received
from holdfast.estimator.learnt_view import LearntView
from holdfast.estimator.standstill import Standing
from holdfast.estimator.tracking import Update
from holdfast.graph.nodes import to_grid
from holdfast.messages import Array
from holdfast.sensors.constants import Constant
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.noise import Colour
from holdfast.sensors.sensor import Joint, Measurement
from holdfast.smoothing.block import Mounted

UNKNOWN = np.diag(np.repeat([0.1, 10.0, 1.0], 3) ** 2)  # of an estimate whose covariance was not kept


class Beside(NamedTuple):
    """What is known beside a measurement, as of its arrival.

    Attributes:
        joint: the turn joint at its time.
        colour: how its error is composed, if its slow part is a state.
    """

    joint: Joint | None
    colour: Colour | None


class _Waiting(NamedTuple):
    stamp_ns: int
    order: int
    measurement: Measurement
    beside: Beside


class Recorded:
    """The samples and measurements of the last minutes, and what the causal estimator made of them."""

    def __init__(self, config: Config) -> None:
        self.buffer = ImuBuffer(config.imu)
        self._waiting: list[_Waiting] = []
        self._order = 0
        self._navs: dict[int, gtsam.NavState] = {}
        self._covariances: dict[int, Array] = {}
        self._covariance_stamps: list[int] = []
        self._names = [*config.sensors]
        self._used: set[tuple[str, int]] = set()  # sensor and stamp: the estimator may have put another weight on it
        self._noise: dict[str, tuple[list[int], list[float]]] = {}
        self._beside: dict[int, Beside] = {}
        self._mounted: dict[int, tuple[Array, Array]] = {}  # p_I_B and R_I_B, by the time of the sample
        self._learnt: LearntView | None = None
        self.settled_ns = 0

    def receive(self, received: Received) -> None:
        """Take in a usable sample."""
        if received.begins_anew:
            self.buffer.clear()
        self.buffer.add(received.sample)
        if received.base is not None and received.estimate is not None:
            in_world, base = received.estimate, received.base.T_W_B
            back = in_world.rotation.T
            position = back @ (base.translation() - in_world.position)
            self._mounted[self.buffer.latest_ns] = position, back @ base.rotation().matrix()

    def add(self, measurement: Measurement, joint: Joint | None = None) -> None:
        """Take in a checked measurement, which may be late."""
        self._order += 1
        beside = Beside(joint, self._colour(measurement))
        insort(self._waiting, _Waiting(measurement.stamp_ns, self._order, measurement, beside))

    def update(self, update: Update, learnt: LearntView) -> None:
        """Take in what the causal estimator found."""
        state, self._learnt = update.state, learnt
        self.buffer.sway = learnt.sway()
        if not update.begins_anew:
            stamp = to_grid(state.stamp_ns)
            if not self._covariance_stamps or stamp > self._covariance_stamps[-1]:
                self._covariance_stamps.append(stamp)
            self._covariances[stamp] = state.covariance[:9, :9]
        before_ns = self.settled_ns
        for stamp_ns, nav in update.smoothed:
            self._navs[stamp_ns] = nav
            self.settled_ns = stamp_ns
        if self.settled_ns > before_ns:
            self._used |= {(one.sensor, one.stamp_ns) for one in learnt.used(before_ns, self.settled_ns)}
        for stamp_ns in update.standing:
            self.add(Standing(stamp_ns))
        for name in self._names:
            stamps, ratios = self._noise.setdefault(name, ([0], [1.0]))
            if learnt.noise(name) != ratios[-1]:
                stamps.append(state.stamp_ns)
                ratios.append(learnt.noise(name))

    def take(self, until_ns: int) -> Iterator[tuple[int, Measurement]]:
        """Yield and drop the measurements until a time, in the order of stamps."""
        k = bisect_right(self._waiting, until_ns, key=lambda one: one.stamp_ns)
        taken, self._waiting = self._waiting[:k], self._waiting[k:]
        self._beside = {id(one.measurement): one.beside for one in taken}
        for one in taken:
            yield one.stamp_ns, one.measurement

    def drop_before(self, time_ns: int) -> None:
        """Drop what is older than a time."""
        self._waiting = [one for one in self._waiting if one.stamp_ns >= time_ns]
        self.buffer.forget_before(time_ns)
        self._used = {one for one in self._used if one[1] >= time_ns}
        self._mounted = {stamp: one for stamp, one in self._mounted.items() if stamp >= time_ns}
        self._navs = {stamp: nav for stamp, nav in self._navs.items() if stamp >= time_ns}
        self._covariances = {stamp: one for stamp, one in self._covariances.items() if stamp >= time_ns}
        self._covariance_stamps = sorted(self._covariances)

    def mounted(self, times_ns: NDArray[np.int64]) -> Mounted:
        """Return where the chassis was at the samples of some times (N,)."""
        found = [(row, *self._mounted[time]) for row, time in enumerate(times_ns.tolist()) if time in self._mounted]
        rows, positions, rotations = zip(*found, strict=True) if found else ((), (), ())
        return Mounted(
            np.array(rows, dtype=np.int64), np.array(positions).reshape(-1, 3), np.array(rotations).reshape(-1, 3, 3)
        )

    def was_used(self, measurement: Measurement) -> bool | None:
        """Whether the causal estimator had a measurement in its graph in the end; None if that is not known yet."""
        return (
            None if measurement.stamp_ns > self.settled_ns else (measurement.sensor, measurement.stamp_ns) in self._used
        )

    def beside(self, measurement: Measurement) -> Beside:
        """Return what is known beside a measurement that was just taken."""
        return self._beside[id(measurement)]

    def is_off(self, constant: str) -> bool:
        """Whether the causal estimator has found a constant of a sensor to be otherwise than configured."""
        found = self._constant(constant)
        return found is not None and found.is_off

    def believed_rad(self, constant: str) -> float:
        """Return what the causal estimator believes of a constant that is an angle [rad]; zero until it knows."""
        found = self._constant(constant)
        return 0.0 if found is None else float(found.value[0])

    def _constant(self, name: str) -> Constant | None:
        return None if self._learnt is None else self._learnt.constants().get(name)

    @property
    def force_scale(self) -> float:
        """How many times larger the error of the accelerometer in proportion to the motion is than configured."""
        return 1.0 if self._learnt is None else self._learnt.force_scale()

    def _colour(self, measurement: Measurement) -> Colour | None:
        colour: Colour | None = getattr(measurement, "colour", None)
        if colour is None or self._learnt is None:
            return colour
        return self._learnt.colour(measurement.sensor, colour, max(1.0, self.noise(measurement)))

    def nav(self, time_ns: int) -> gtsam.NavState | None:
        """Return the state that the causal estimator's window left at a node, if it had one there."""
        return self._navs.get(time_ns)

    def covariance(self, time_ns: int) -> Array:
        """Return the covariance (9, 9) that the causal estimate had at a time."""
        k = bisect_left(self._covariance_stamps, to_grid(time_ns))
        stamps = self._covariance_stamps[k : k + 1] or self._covariance_stamps[-1:]
        return self._covariances[stamps[0]] if stamps else UNKNOWN

    def noise(self, measurement: Measurement) -> float:
        """Return the factor on the covariance of a measurement that the estimator has learnt."""
        stamps, ratios = self._noise.get(measurement.sensor, ([0], [1.0]))
        ratio = ratios[bisect_right(stamps, measurement.stamp_ns) - 1]
        return ratio * ratio
