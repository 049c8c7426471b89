"""Zero-velocity updates: where the IMU was quiet and the speed agrees, never assumed."""

from collections.abc import Iterable

import numpy as np

from holdfast.config.model import StandstillConfig
from holdfast.graph.smoother import Smoother
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.standstill import quiet_window

MIN_PERIOD_NS = 100_000_000


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
        sigma = float(np.sqrt(smoother.covariance(node)[6:9, 6:9].trace()))
        return speed < self._config.max_speed_m_s + 3.0 * sigma
