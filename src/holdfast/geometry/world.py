"""The world frame W: east, north and up of a datum that is given, or that the first positions on the ellipsoid set."""

from math import cos, radians, remainder

import numpy as np

from holdfast.geometry.earth import Geodetic, LocalFrame, gravity_at
from holdfast.messages import Array

NEAR_DEG = 0.1  # 11 km, over which up turns by as much; of longitude at the equator
AGREEING = 3  # successive points elsewhere that are no outliers
MOVED = "the first position was far from those that followed: W begins at these now"


class World:
    """W, and where it is on the earth once that is known; until it is settled, it follows the points.

    The first fix of a receiver may be thousands of kilometres off, and far from the datum up in W is not up. So
    W moves to where three successive points are, until an estimate has begun in it, unless its datum is given.

    Args:
        frame: where W is, if that is known.
    """

    def __init__(self, frame: LocalFrame | None = None) -> None:
        self.frame = frame
        self._is_settled = frame is not None
        self._here: Geodetic | None = None
        self._elsewhere: list[Geodetic] = []

    @property
    def datum(self) -> Geodetic | None:
        """The origin of W on the ellipsoid, None until there is one."""
        return None if self.frame is None else self.frame.datum

    @property
    def gravity(self) -> float:
        """Normal gravity at the datum [m/s^2], the standard one until there is a datum."""
        return gravity_at(self.datum)

    @property
    def axes(self) -> Array:
        """R_W_E (3, 3): east, north and up where the last points are, outliers left out, in W."""
        return np.eye(3) if self.frame is None or self._here is None else self.frame.axes_at(self._here)

    def place(self, datum: Geodetic) -> None:
        """Put the origin of W somewhere, where it stays."""
        self.frame = LocalFrame(datum)
        self.settle()

    def settle(self) -> None:
        """Let W stay where it is, if it is anywhere."""
        self._is_settled = self.frame is not None

    def to_enu(self, point: Geodetic) -> Array:
        """Return the (3,) position of a point in W [m]; the first points set the datum."""
        here = self._here = self._where(point)
        if self.frame is None or not (self._is_settled or _are_near(here, self.frame.datum)):
            self.frame = LocalFrame(here)
        return self.frame.to_enu(point)

    def _where(self, point: Geodetic) -> Geodetic:
        """Return where the machine is: at the newest point, or where it was while points elsewhere may be outliers."""
        if self._here is None or _are_near(point, self._here):
            self._elsewhere = []
            return point
        if self._elsewhere and not _are_near(point, self._elsewhere[-1]):
            self._elsewhere = []
        self._elsewhere.append(point)
        return point if len(self._elsewhere) >= AGREEING else self._here


def _are_near(one: Geodetic, other: Geodetic) -> bool:
    """Whether two points are within some kilometres of each other, whatever their height."""
    east_deg = remainder(one.longitude_deg - other.longitude_deg, 360.0) * cos(radians(one.latitude_deg))
    return abs(one.latitude_deg - other.latitude_deg) < NEAR_DEG and abs(east_deg) < NEAR_DEG
