"""A machine is not faster than machines are: what bounds a velocity that only the IMU tells, for minutes."""

from collections.abc import Iterable
from dataclasses import dataclass

from holdfast.config.model import GateConfig
from holdfast.graph.smoother import Smoother
from holdfast.measured_fields import NEVER_NS

PERIOD_NS = 1_000_000_000
SIGMAS_AT_MOST = 2.0  # that the fastest machine is from standing


@dataclass(frozen=True, slots=True, eq=False)
class Plausible:
    """The machine is not too fast, as far as is known."""

    stamp_ns: int
    sensor: str = "plausible_speed"


class PlausibleSpeed:
    """Where a velocity is known worse than how fast machines are, it is told that, once a second at most.

    Without it the speed of an estimate that has nothing but an IMU has no bound, nor its covariance: after nine minutes
    a car was at 400 m/s, which is no solution, and the graph began anew there again and again.

    Args:
        config: how fast a machine is.
    """

    def __init__(self, config: GateConfig) -> None:
        self._sigma_m_s = config.max_speed_m_s / SIGMAS_AT_MOST
        self._next_ns = NEVER_NS

    def add_to(self, smoothers: Iterable[Smoother]) -> None:
        """Add a factor at the newest node of every smoother whose velocity is so uncertain."""
        due_ns = self._next_ns
        for smoother in smoothers:
            newest_ns, variances = smoother.newest_ns, smoother.newest.covariance.diagonal()[6:9]
            if newest_ns >= due_ns and float(variances.max()) > self._sigma_m_s**2:
                smoother.enter_zero_velocity(Plausible(newest_ns), self._sigma_m_s)
                self._next_ns = newest_ns + PERIOD_NS
