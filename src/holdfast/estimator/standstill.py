"""Standstill: detected from the spread of the IMU readings, never assumed."""

from collections.abc import Iterable

import numpy as np

from holdfast.config.model import StandstillConfig
from holdfast.graph.smoother import Smoother
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer

MAX_MEAN_RATE_RAD_S = 0.05  # turning evenly is not standing; a bias is smaller
MIN_PERIOD_NS = 100_000_000
CHANGE_SHARE = 0.1  # of the allowed spread, by which the mean may change within the window
BATCHES = 10  # parts of the window whose means are compared: an engine averages out in each, a motion does not


def quiet_window(
    config: StandstillConfig, buffer: ImuBuffer, end_ns: int, length_s: float, vibration: float = 1.0
) -> tuple[Array, Array] | None:
    """Return mean specific force [m/s^2] and angular velocity [rad/s] over the window if the IMU was quiet, else None.

    Quiet is a standard deviation below the bounds on every axis, and the same mean in both halves of the window: engine
    vibration may be stronger than the acceleration with which a machine creeps away. It cannot tell standstill from
    even motion: ask for the speed as well. An engine may shake `vibration` times as much as the bounds allow, as long
    as the means of parts of the window stay within them.
    """
    window = buffer.window(end_ns - round(length_s * 1e9), end_ns)
    if window is None:
        return None
    means: list[Array] = []
    for readings, spread in zip(window, (config.max_acceleration, config.max_angular_rate_rad_s), strict=True):
        half = len(readings) // 2
        change = abs(readings[half:].mean(axis=0) - readings[:half].mean(axis=0))
        batches = np.array([part.mean(axis=0) for part in np.array_split(readings, min(BATCHES, len(readings)))])
        deviation = batches.std(axis=0, ddof=1)
        # the means of two halves differ by so much where nothing but noise and vibration differs
        allowed = spread * CHANGE_SHARE + 3.0 * deviation * np.sqrt(4.0 / len(batches))
        if deviation.max() > spread or readings.std(axis=0).max() > vibration * spread or (change > allowed).any():
            return None
        means.append(readings.mean(axis=0))
    if float(np.linalg.norm(means[1])) > MAX_MEAN_RATE_RAD_S:
        return None
    return means[0], means[1]


class StandstillUpdates:
    """Zero-velocity factors at fixed times, in the middle of quiet windows that the IMU has passed.

    The middle is at rest even if the machine creeps away at the end; fixed times do not depend on arrivals.
    """

    def __init__(self, config: StandstillConfig, buffer: ImuBuffer) -> None:
        self._config = config
        self._buffer = buffer
        self._half_ns = round(0.5e9 * config.window_s)
        self._period_ns = max(self._half_ns, MIN_PERIOD_NS)
        self._next_ns = 0

    def add_to(self, smoothers: Iterable[Smoother]) -> int:
        """Add the factors that have become certain, to every smoother; return how many times it stood."""
        every = list(smoothers)
        end = self._buffer.latest_ns - self._half_ns
        oldest = max(smoother.oldest_ns for smoother in every)
        first = max(self._next_ns, -(-oldest // self._period_ns) * self._period_ns)
        added = 0
        for stamp in range(first, end + 1, self._period_ns) if self._config.enabled else ():
            self._next_ns = stamp + self._period_ns
            if all(stamp <= smoother.newest_ns and self._is_standing(stamp, smoother) for smoother in every):
                for smoother in every:
                    smoother.node(stamp)
                    smoother.add_zero_velocity(stamp, self._config.velocity_sigma_m_s)
                added += 1
        return added

    def _is_standing(self, stamp_ns: int, smoother: Smoother) -> bool:
        if quiet_window(self._config, self._buffer, stamp_ns + self._half_ns, self._config.window_s) is None:
            return False
        node = smoother.last_before(stamp_ns)
        if node is None:
            return False
        speed = float(np.linalg.norm(smoother.nav(node).velocity()))
        spread = float(np.sqrt(smoother.covariance(node)[6:9, 6:9].trace()))
        return speed < self._config.max_speed_m_s + 3.0 * spread
