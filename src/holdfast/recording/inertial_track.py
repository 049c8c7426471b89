"""What an IMU felt since the start of a stretch: the sums from which the motion of an antenna beside it follows."""

import numpy as np

from holdfast.geometry.rotations import attitudes, skew
from holdfast.messages import Array


class InertialTrack:
    """Velocity and position of an antenna in I at the start, up to what the IMU cannot know.

    R (N, 3, 3) is the attitude since the start by the gyroscope. To first order in the biases b_a, b_g and for a lever
    arm l, an antenna moves at

        S(t) + H(t) [b_a; b_g; l],    S = int R f,    H = [-int R, int [R f]x int R, R [omega]x],

    beside its first velocity and gravity; its position is the integral.

    Args:
        times_s: (N,), increasing, from about 0.
        readings: (N, 6) angular velocity [rad/s] and specific force [m/s^2].
    """

    def __init__(self, times_s: Array, readings: Array) -> None:
        steps = np.diff(times_s)
        R = attitudes((readings[1:, :3] + readings[:-1, :3]) * (0.5 * steps[:, None]))
        force = np.einsum("nij,nj->ni", R, readings[:, 3:])
        turned = _integral(R, steps)
        tilted = _integral(skew(force) @ turned, steps)
        sensed = np.concatenate([_integral(force, steps)[:, :, None], -turned, tilted], axis=2)
        self._times_s = times_s
        self._sums = (
            np.concatenate([sensed, R @ skew(readings[:, :3])], axis=2),
            np.concatenate([_integral(sensed, steps), R], axis=2),
        )

    def at(self, times_s: Array, order: int) -> Array:
        """Return S and H (..., 3, 10) at times (...): of velocity for order 1, of position for 2."""
        t, sums = self._times_s, self._sums[order - 1]
        k = np.clip(np.searchsorted(t, times_s), 1, len(t) - 1)
        fraction = ((times_s - t[k - 1]) / (t[k] - t[k - 1]))[..., None, None]
        result: Array = sums[k - 1] * (1.0 - fraction) + sums[k] * fraction
        return result


def _integral(values: Array, steps: Array) -> Array:
    """Return the integral of values (N, ...) since the first one, by trapezoids."""
    total = np.zeros_like(values)
    np.cumsum(0.5 * (values[1:] + values[:-1]) * steps.reshape(-1, *[1] * (values.ndim - 1)), axis=0, out=total[1:])
    return total
