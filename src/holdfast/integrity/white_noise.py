"""Which part of what a sensor claims is white: what successive measurements differ by, beside the motion."""

import numpy as np

from holdfast.events import Outcome
from holdfast.graph.smoother import Smoother
from holdfast.integrity.learnt_snapshot import LearntNoiseScale
from holdfast.sensors.noise import Colour
from holdfast.sensors.sensor import Comparing, Measurement, State

MAX_INTERVAL_NS = 250_000_000  # over which the IMU knows the motion better than the measurements
PRIOR, ENOUGH, MEMORY = 5, 60, 300  # differences
EVERY = 5  # measurements, of which the last two are compared once enough is known
MAX_RATIO = 9.0  # one difference tells no more


class WhiteNoise:
    """The variance of the white part of one sensor's errors, in units of what it claims: (63) in docs/math.md.

    Args:
        carried: what was learnt before, which weighs no more than `ENOUGH` differences.
    """

    def __init__(self, carried: LearntNoiseScale | None = None) -> None:
        self._count = 0 if carried is None else min(carried.white_count, ENOUGH)
        self._received = 0
        self._variance: float | None = None if carried is None else carried.white_variance
        self._last: Measurement | None = None

    @property
    def variance(self) -> float | None:
        """The variance; None while nothing was learnt."""
        return self._variance

    @property
    def count(self) -> int:
        """How many differences it rests on."""
        return self._count

    def colour(self, colour: Colour, above: float) -> Colour:
        """Return how an error is composed whose claim is believed times a factor."""
        return colour if self._variance is None else colour.with_white(self._variance / above)

    def learn(  # noqa: PLR0917 (a measurement and all that it is compared with)
        self,
        sensor: Comparing,
        measurement: Measurement,
        colour: Colour,
        smoother: Smoother,
        state: State,
        above: float = 1.0,
    ) -> None:
        """Take in a measurement that was used, in the order of stamps.

        Args:
            sensor: that measured.
            measurement: it.
            colour: of its error.
            smoother: whose state it is compared with.
            state: there, at its time.
            above: by how much its covariance is larger than what is claimed.
        """
        self._received += 1
        if self._count > ENOUGH and self._received % EVERY < EVERY - 2:
            return
        last, self._last = self._last, measurement
        if last is None or not smoother.has_node(last.stamp_ns):
            return
        if not 0 < measurement.stamp_ns - last.stamp_ns <= MAX_INTERVAL_NS:
            return
        then = smoother.mean_at(last.stamp_ns)._replace(
            joint=state.joint, parameter=state.parameter, parameter_covariance=state.parameter_covariance
        )
        before = sensor.innovation(last, then)
        now = sensor.innovation(measurement, state)
        if isinstance(before, Outcome) or isinstance(now, Outcome):
            return
        self._take(float(np.mean((now.y - before.y) ** 2 / now.R.diagonal())) * 0.5 * above, colour)

    def _take(self, ratio: float, colour: Colour) -> None:
        """Take in the square of a difference, in units of twice the variance that is claimed."""
        variance = colour.white if self._variance is None else self._variance
        weight = 1.0 / (PRIOR + min(self._count, MEMORY))
        self._variance = variance + weight * (min(ratio, MAX_RATIO * variance) - variance)
        self._count += 1
