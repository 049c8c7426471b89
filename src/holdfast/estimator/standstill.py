"""Zero-velocity updates: where the IMU was quiet and everything else agrees that the machine stands, never assumed."""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import gtsam
import numpy as np

from holdfast.config.model import StandstillConfig
from holdfast.graph.smoother import Smoother
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.standstill import quiet_window

MIN_PERIOD_NS = 100_000_000
KNOWN_SPEED_M_S = 0.3  # 3 sigma of a velocity that is known well enough to tell standstill from even motion
TILT_AND_BIAS = [0, 1, 2, 9, 10, 11]  # of a covariance of state and biases
ACCELERATION_SLACK_M_S2 = 0.05
STANDSTILL = "standstill"  # as a source of measurements

Stands = Callable[[int, float], bool | None]
"""Returns whether the fixes until a time [ns] stood for a duration [s], None while they cannot tell."""


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """The machine stood, as far as is known."""

    stamp_ns: int
    sensor: str = STANDSTILL


class StandstillUpdates:
    """Zero-velocity factors at fixed times, in the middle of quiet windows that another one follows.

    The last quiet window before the machine sets off holds the beginning of the motion; fixed times do not depend on
    arrivals.

    Args:
        config: of the updates.
        buffer: of the IMU's samples.
        gravity: [m/s^2].
        stands: asks the fixes.
    """

    def __init__(self, config: StandstillConfig, buffer: ImuBuffer, gravity: float, stands: Stands) -> None:
        self._config = config
        self._buffer = buffer
        self._gravity = np.array([0.0, 0.0, gravity])
        self._stands = stands
        self._half_ns = round(0.5e9 * config.window_s)
        self._period_ns = max(self._half_ns, MIN_PERIOD_NS)
        self._next_ns = NEVER_NS
        self._added: deque[Standing] = deque()

    def add_to(self, smoothers: Iterable[Smoother]) -> list[int]:
        """Add the factors that have become certain, to every smoother; return the times at which it stood."""
        every = list(smoothers)
        end = self._buffer.latest_ns - self._half_ns - self._period_ns
        oldest = max(smoother.oldest_ns for smoother in every)
        while self._added and self._added[0].stamp_ns < oldest:
            self._added.popleft()
        first = max(self._next_ns, -(-oldest // self._period_ns) * self._period_ns)
        added: list[int] = []
        for stamp in range(first, end + 1, self._period_ns) if self._config.enabled else ():
            self._next_ns = stamp + self._period_ns
            if all(stamp <= smoother.newest_ns and self._is_standing(stamp, smoother) for smoother in every):
                standing = Standing(stamp)
                for smoother in every:
                    smoother.enter_zero_velocity(standing, self._config.velocity_sigma_m_s)
                self._added.append(standing)
                added.append(stamp)
        return added

    def take_back(self, smoothers: Iterable[Smoother]) -> int:
        """Take the factors in the windows out again, which something contradicts; return how many there were."""
        taken = len(self._added)
        for smoother in smoothers:
            for standing in self._added:
                smoother.retract(standing)
        self._added.clear()
        return taken

    def _is_standing(self, stamp_ns: int, smoother: Smoother) -> bool:
        end_ns = stamp_ns + self._half_ns
        quiet, node = self._quiet(end_ns), smoother.last_before(stamp_ns)
        if quiet is None or node is None or self._quiet(end_ns + self._period_ns) is None:
            return False
        nav, newest = smoother.nav(node), smoother.newest  # whose covariance is at hand, that of a node is not
        doubt = 3.0 * float(np.sqrt(newest.covariance[6:9, 6:9].trace()))
        if np.linalg.norm(nav.velocity()) > self._config.max_speed_m_s + doubt:
            return False
        if self._is_accelerating(quiet[0], nav, newest.bias, newest.covariance):
            return False
        stand = self._stands(end_ns, self._config.window_s)
        return doubt < KNOWN_SPEED_M_S if stand is None else stand

    def _quiet(self, end_ns: int) -> tuple[Array, Array] | None:
        return quiet_window(self._config, self._buffer, end_ns, self._config.window_s)

    def _is_accelerating(
        self, force: Array, nav: gtsam.NavState, bias: gtsam.imuBias.ConstantBias, covariance: Array
    ) -> bool:
        """Whether the mean specific force is not gravity alone: a machine that brakes evenly is quiet as well."""
        unbiased = force - bias.accelerometer()
        acceleration = nav.attitude().rotate(unbiased) - self._gravity
        of_both = covariance[np.ix_(TILT_AND_BIAS, TILT_AND_BIAS)]  # they err together
        H = np.hstack([gtsam.SO3.Hat(unbiased), np.eye(3)])
        sigma = float(np.sqrt((H @ of_both @ H.T).trace()))
        return float(np.linalg.norm(acceleration)) > 3.0 * sigma + ACCELERATION_SLACK_M_S2
