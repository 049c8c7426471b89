"""The world frame W: east, north and up of a datum that is given, or that the first position on the ellipsoid sets."""

from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.messages import Array


class World:
    """W, and where it is on the earth once that is known."""

    def __init__(self) -> None:
        self.frame: LocalFrame | None = None

    @property
    def datum(self) -> Geodetic | None:
        """The origin of W on the ellipsoid, None until there is one."""
        return None if self.frame is None else self.frame.datum

    def place(self, datum: Geodetic) -> None:
        """Put the origin of W somewhere."""
        self.frame = LocalFrame(datum)

    def to_enu(self, point: Geodetic) -> Array:
        """Return the (3,) position of a point in W [m]; the first point becomes the datum."""
        if self.frame is None:
            self.place(point)
            assert self.frame is not None
        return self.frame.to_enu(point)
