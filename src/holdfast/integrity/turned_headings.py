"""Headings that are refused, but beside the estimate by the same angle wherever it turns: mounted otherwise, not wrong.

What shows another sign, or wanders as a compass does beside iron, is elsewhere at each attitude.
"""

from math import radians, remainder, tau

SAME_RAD, SIGMA = radians(3.0), 4.0  # of headings that are beside the estimate alike
TURNED_RAD = radians(60.0)  # by which the machine must have turned meanwhile


class TurnedHeadings:
    """The newest of one sensor that were refused in a row, as long as they are alike."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget them: one was as expected."""
        self._first_rad: float | None = None
        self._beside_rad, self._count = 0.0, 0  # mean, from the first
        self._yaw_rad = self._least_rad = self._most_rad = 0.0  # of the estimate, unwrapped, from the first

    def note(self, off_rad: float, sigma_rad: float, yaw_rad: float) -> float | None:
        """Take in a heading that was refused; return the angle [rad] that all are beside the estimate, once it is sure.

        Args:
            off_rad: by which it is beside the estimate.
            sigma_rad: of it.
            yaw_rad: heading of the estimate.
        """
        if self._first_rad is not None:
            beside_rad = remainder(off_rad - self._first_rad, tau)
            if abs(beside_rad - self._beside_rad) > SAME_RAD + SIGMA * sigma_rad:
                self.clear()
        if self._first_rad is None:
            self._first_rad, self._yaw_rad = off_rad, yaw_rad
            self._least_rad = self._most_rad = yaw_rad
        self._count += 1
        self._beside_rad += (remainder(off_rad - self._first_rad, tau) - self._beside_rad) / self._count
        self._yaw_rad += remainder(yaw_rad - self._yaw_rad, tau)
        self._least_rad = min(self._least_rad, self._yaw_rad)
        self._most_rad = max(self._most_rad, self._yaw_rad)
        if self._most_rad - self._least_rad < TURNED_RAD:
            return None
        return remainder(self._first_rad + self._beside_rad, tau)
