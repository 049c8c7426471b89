"""By how much an attitude is beside the heading that is measured: where a drop-out has left it vague, it is turned."""

from collections.abc import Mapping
from math import remainder, tau
from typing import Any

import gtsam

from holdfast.estimator.collected import Collected, between
from holdfast.estimator.first_heading import PAIRED_NS, Antennas, baseline_heading
from holdfast.estimator.travel_direction import TravelDirection
from holdfast.estimator.velocity_check import VelocityCheck

LATE_NS = 1_000_000_000  # since which a measurement is one of now
MOST_RAD = 0.35  # sigma of a heading that tells anything


class Compass:
    """Compares attitudes with headings, with two antennas, and with the course.

    Args:
        collected: what was measured of late.
        antennas: two whose lever arms are not in doubt, if there are.
        headings: models of sensors of heading, by name.
        velocities: tells whose have proven right.

    Attributes:
        travel: in which of its own directions the machine travels.
    """

    def __init__(
        self, collected: Collected, antennas: Antennas | None, headings: Mapping[str, Any], velocities: VelocityCheck
    ) -> None:
        self._collected, self._antennas, self._headings, self._velocities = collected, antennas, headings, velocities
        self.travel = TravelDirection()

    def beside(self, stamp_ns: int, attitude: gtsam.Rot3) -> float | None:
        """Return by how much an attitude at a time must be turned about the vertical [rad] to be as is measured.

        Headings and two antennas say so, or else the course; None where none has of late.
        """
        since_ns, found = stamp_ns - LATE_NS, list[tuple[float, float] | str | None]()
        for heading in self._collected.newest_of(self._headings):
            if heading.stamp_ns >= since_ns:
                found.append(self._headings[heading.sensor].of_imu(heading, attitude))
        if self._antennas is not None and (positions := self._collected.positions):
            paired_ns = max(since_ns, positions[-1].stamp_ns - PAIRED_NS)
            found.append(baseline_heading(self._antennas, positions, paired_ns, attitude))
        told = [one for one in found if isinstance(one, tuple) and one[1] < MOST_RAD]
        if not told:
            return self.beside_course(stamp_ns, attitude)
        return remainder(min(told, key=lambda one: one[1])[0], tau)

    def beside_course(self, stamp_ns: int, attitude: gtsam.Rot3) -> float | None:
        """Return the same as the course alone says, of a machine that travels in one direction of its own."""
        proven = self._collected.velocities_of(self._velocities.proven)
        recent = between(proven, stamp_ns - LATE_NS, stamp_ns)
        return self.travel.turned_beside(attitude, recent[-1]) if recent else None
