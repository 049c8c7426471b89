"""Positions that wander, as where streets are narrow: wrong by tens of metres for minutes, while they claim a metre.

Velocities that have proven right and agree with the estimate tell them from an estimate that is wrong; else only that
they depart from it roughly, for an estimate is left smoothly. They are then believed as far as their distance shows.
"""

from holdfast.estimator.initialisation import Initialising
from holdfast.estimator.velocity_check import Company
from holdfast.integrity.positions import Positions
from holdfast.integrity.states import States
from holdfast.measured_fields import NEVER_NS
from holdfast.sensors.sensor import Role

WINDOW_NS = 10_000_000_000  # in which positions and velocities are compared
LATCH_NS = 60_000_000_000  # what was astray is so until a way is seen beside velocities, but no longer
BOASTING_NS = 30_000_000_000  # what is astray for so long is noisier than it claims


class Wandering:
    """Knows which receivers wander.

    Args:
        start: that collects what was measured.
        states: the sensors of velocity.
        positions: the receivers, which it tells.
    """

    def __init__(self, start: Initialising, states: States, positions: Positions) -> None:
        self._start, self._states, self._positions = start, states, positions
        self._since_ns: dict[str, int] = {}  # by receiver: from when until when it was astray
        self._seen_ns: dict[str, int] = {}

    def review(self, now_ns: int) -> None:
        """Look at the receivers that the estimate refuses."""
        lost, suspects = self._positions.lost(), self._positions.suspects()
        for name, seen_ns in self._seen_ns.items():  # what has wandered is right now and then, too
            if name in lost and now_ns - seen_ns <= LATCH_NS:
                suspects.setdefault(name, NEVER_NS)
        agreeing = self._states.agreeing(Role.VELOCITY) if suspects else set()
        found = set()
        for name, since_ns in suspects.items():
            company = self._company(name, since_ns, agreeing, now_ns)
            is_rough = company is Company.UNKNOWN and self._positions.is_rough(name)
            if is_rough or company is Company.ASTRAY:
                found.add(name)
            if is_rough or (name in found and now_ns - self._since_ns[name] > BOASTING_NS):
                self._positions.doubt(name)
        self._positions.wandering = found

    def _company(self, name: str, since_ns: int, agreeing: set[str], now_ns: int) -> Company:
        """Return how the positions of a receiver go beside velocities that agree with the estimate."""
        company = self._start.company(agreeing, name, max(since_ns, now_ns - WINDOW_NS))
        seen_ns = self._seen_ns.get(name, NEVER_NS)
        if company is Company.ASTRAY:
            if now_ns - seen_ns > LATCH_NS:
                self._since_ns[name] = now_ns
            self._seen_ns[name] = now_ns
        was_astray = bool(agreeing) and now_ns - seen_ns <= LATCH_NS
        return Company.ASTRAY if company is Company.UNKNOWN and was_astray else company
