"""Delayed measurements by buffering: a late one is taken in at its own time, and what followed is recomputed.

Lynen et al. 2013, IV-B, with two differences that serve the baseline: a measurement is taken in at its time and not at
the nearest buffered state, and only states right after a measurement are buffered, because the IMU's samples are.
"""

from bisect import bisect_left
from collections.abc import Sequence
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

import gtsam

from holdfast.baselines.intake import Measurement
from holdfast.baselines.propagation import Propagation
from holdfast.events import Outcome
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import Step


class Belief(Protocol):
    """The belief of a filter at a time: state and uncertainty."""

    stamp_ns: int
    nav: gtsam.NavState
    bias: gtsam.imuBias.ConstantBias
    bias_accel: Array
    bias_gyro: Array

    def copy(self) -> Self:
        """Return a copy that goes on by itself."""
        ...

    def nav_covariance(self) -> Array:
        """Return the covariance (9, 9) of `nav`."""
        ...

    def covariance(self) -> Array:
        """Return the covariance (15, 15) of `nav` and `bias`."""
        ...


B = TypeVar("B", bound=Belief)
B_contra = TypeVar("B_contra", bound=Belief, contravariant=True)


class Filter(Protocol[B_contra]):
    """The mathematics of a filter; the state in `nav` has been propagated already when `predict` is called."""

    def predict(self, belief: B_contra, model: Propagation) -> None:
        """Propagate the uncertainty over the step that `model` has just linearised."""
        ...

    def update(self, belief: B_contra, measurement: Measurement) -> Outcome:
        """Take in a measurement at the belief's time."""
        ...


class Entry(NamedTuple, Generic[B]):
    """A measurement that was taken in, and the belief right after it."""

    measurement: Measurement
    after: B


class Rewinder(Generic[B]):
    """The buffer of beliefs over the last `lag_ns`, from which late measurements are processed."""

    def __init__(self, filter_: Filter[B], buffer: ImuBuffer, model: Propagation, start: B, lag_ns: int) -> None:
        self._filter = filter_
        self._buffer = buffer
        self._model = model
        self._lag_ns = lag_ns
        self._root = start
        self._entries: list[Entry[B]] = []

    @property
    def oldest_ns(self) -> int:
        """Measurements before this cannot be taken in any more."""
        return self._root.stamp_ns

    @property
    def newest(self) -> B:
        """The belief right after the newest measurement."""
        return self._entries[-1].after if self._entries else self._root

    def take(self, measurements: Sequence[Measurement]) -> list[Outcome]:
        """Take in measurements, none older than `oldest_ns`, and recompute what followed the first of them."""
        new = sorted(measurements, key=_order)
        cut = bisect_left(self._entries, _order(new[0]), key=lambda entry: _order(entry.measurement))
        again = self._entries[cut:]
        del self._entries[cut:]
        belief = self.newest.copy()
        outcomes = {}
        for measurement in sorted([*(entry.measurement for entry in again), *new], key=_order):
            self.carry(belief, measurement.stamp_ns)
            outcomes[id(measurement)] = self._filter.update(belief, measurement)
            self._entries.append(Entry(measurement, belief.copy()))
        self._forget()
        return [outcomes[id(measurement)] for measurement in measurements]

    def carry(self, belief: B, stamp_ns: int) -> None:
        """Propagate a belief to a later time by the buffered samples of the IMU."""
        if stamp_ns <= belief.stamp_ns:
            return
        for piece in self._buffer.pieces(belief.stamp_ns, stamp_ns):
            if piece.is_gap:
                self.coast(belief, piece.end_ns)
                continue
            for step in self._buffer.steps(piece.start_ns, piece.end_ns):
                self.step(belief, step)
            belief.stamp_ns = piece.end_ns

    def step(self, belief: B, step: Step) -> None:
        """Propagate a belief over one step; its stamp is left to the caller."""
        belief.nav = self._model.advance(belief.nav, belief.bias, belief.bias_accel, belief.bias_gyro, step)
        self._filter.predict(belief, self._model)

    def coast(self, belief: B, stamp_ns: int) -> None:
        """Propagate a belief over a drop-out of the IMU."""
        rate = self._buffer.angular_velocity(belief.stamp_ns) - belief.bias_gyro
        duration_s = (stamp_ns - belief.stamp_ns) * 1e-9
        belief.nav = self._model.coast(belief.nav, belief.bias, rate, duration_s)
        self._filter.predict(belief, self._model)
        belief.stamp_ns = stamp_ns

    def _forget(self) -> None:
        oldest = self._entries[-1].measurement.stamp_ns - self._lag_ns
        count = bisect_left(self._entries, oldest, key=lambda entry: entry.measurement.stamp_ns)
        if count > 0:
            self._root = self._entries[count - 1].after
            del self._entries[:count]


def _order(measurement: Measurement) -> tuple[int, str]:
    return measurement.stamp_ns, measurement.sensor
