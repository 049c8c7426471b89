"""How a machine goes on turning where its IMU falls silent, as its gyroscope has shown: (89) in docs/math.md.

What shakes a car is over in a moment, what turns it goes on, and it hardly tilts: no one noise says all that. So the
mean rate of the next seconds is a regression on the rate at their start, of all three axes on all three.
"""

from typing import TYPE_CHECKING, NamedTuple

import gtsam
import numpy as np

from holdfast.messages import Array

if TYPE_CHECKING:
    from holdfast.sensors.imu import ImuBuffer

SPANS_S = 0.3, 1.0, 2.0  # beyond, the angle grows with the time
STEP_NS = 500_000_000  # from one example to the next
MEMORY_S = 600.0
CONFIGURED, RATE_RAD_S = 20.0, 0.05  # what is configured counts as so many examples, of about this rate
STANDS_RAD_S = 0.01  # a machine that turns less stands, or drives straight on: how it turns, it does not tell
LEAST, MOST = 1e-8, 1.0  # density [rad^2/s]: after seconds at the most nothing is known


class Forecast(NamedTuple):
    """How the machine turns: mean rate (3,) [rad/s], and density (3, 3) of its departure from that [rad^2/s]."""

    rate: Array
    density: Array


def _configured(density: float, span_s: float) -> Array:
    """Return the sums of examples of a machine that turns on as it did, but for white noise."""
    x, same, y = RATE_RAD_S**2, RATE_RAD_S**2, RATE_RAD_S**2 + density**2 / span_s
    sums = np.zeros((7, 7))
    sums[:6, :6] = np.kron([[x, same], [same, y]], np.eye(3))
    sums[6, 6] = 1.0
    return CONFIGURED * sums


def _regression(sums: Array) -> tuple[Array, Array]:
    """Return the gain (3, 3), and the covariance of what it leaves (3, 3) [rad^2/s^2]."""
    of_y_and_x = sums[3:6, :3]
    gain = np.asarray(np.linalg.solve(sums[:3, :3], of_y_and_x.T).T, dtype=np.float64)
    return gain, (sums[3:6, 3:6] - gain @ of_y_and_x.T) / sums[6, 6]


class RateForecast:
    """What the samples of an IMU say of how its machine goes on turning.

    For each span it holds the sums over examples of z z^T (7, 7), z = (x, y, 1): x is the rate before it, y the mean
    rate in it, both (3,) in I.
    """

    def __init__(self) -> None:
        self._sums = np.zeros((len(SPANS_S), 7, 7))
        self._next_ns = 0

    def begin_anew(self) -> None:
        """Samples that come are of another clock; what was learnt stays."""
        self._next_ns = 0

    def learn(self, imu: "ImuBuffer", until_ns: int, bias: Array) -> None:
        """Take in what the IMU measured until a time, without a gap; `bias` (3,) [rad/s] is that of the gyroscope."""
        if until_ns < self._next_ns:
            return
        self._next_ns = until_ns + STEP_NS
        for k, span_s in enumerate(SPANS_S):
            start_ns = until_ns - round(span_s * 1e9)
            if not imu.is_trusted(start_ns, until_ns):
                continue
            R = imu.motion(start_ns, until_ns, np.r_[np.zeros(3), bias]).R
            x, y = imu.angular_velocity(start_ns) - bias, gtsam.Rot3.Logmap(gtsam.Rot3(R)) / span_s
            if np.linalg.norm(y) >= STANDS_RAD_S:
                example = np.r_[x, y, 1.0]
                self._sums[k] = (1.0 - STEP_NS * 1e-9 / MEMORY_S) * self._sums[k] + np.outer(example, example)

    def over(self, duration_s: float, silent_s: float, rate: Array, density: float) -> Forecast:
        """Return how the machine turns in a part of a gap.

        Args:
            duration_s: of the part.
            silent_s: for how long the IMU has been silent when it begins.
            rate: (3,) at its start [rad/s].
            density: of the white noise of the turning, as configured [rad/s/sqrt(Hz)].
        """
        pairs = zip(self._sums, SPANS_S, strict=True)
        known = [_regression(sums + _configured(density, span_s)) for sums, span_s in pairs]
        grown = _angle(known, silent_s + duration_s) - _angle(known, silent_s)
        values, axes = np.linalg.eigh(grown / duration_s)
        return Forecast(_gain(known, duration_s) @ rate, (axes * np.clip(values, LEAST, MOST)) @ axes.T)


def _gain(known: list[tuple[Array, Array]], over_s: float) -> Array:
    """Return the gain of the mean rate over a time, between those of the spans; at once the rate is what it was."""
    return _between([np.eye(3), *(gain for gain, _ in known)], over_s)


def _angle(known: list[tuple[Array, Array]], after_s: float) -> Array:
    """Return the covariance (3, 3) of the angle by which the machine has departed from the forecast [rad^2]."""
    grown = [left * span_s**2 for (_, left), span_s in zip(known, SPANS_S, strict=True)]
    return _between([np.zeros((3, 3)), *grown], after_s) * max(1.0, after_s / SPANS_S[-1]) ** 2


def _between(matrices: list[Array], at_s: float) -> Array:
    """Return what is at a time between matrices (3, 3) at zero and at the spans; at most the last."""
    elements = np.array(matrices).reshape(-1, 9).T
    return np.array([np.interp(at_s, [0.0, *SPANS_S], element) for element in elements]).reshape(3, 3)
