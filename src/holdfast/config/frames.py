"""The published frames, and where the world is on the earth."""

from typing import Literal

from pydantic import Field

from holdfast.config.section import Section, quantity
from holdfast.geometry.earth import Geodetic


class Datum(Section):
    """Origin of the world frame W (east, north, up) on the WGS84 ellipsoid."""

    latitude_deg: float = quantity("deg", ge=-90, le=90, doc="geodetic latitude")
    longitude_deg: float = quantity("deg", ge=-180, le=360, doc="longitude")
    altitude_m: float = quantity("m", ge=-1000, le=20000, doc="height above the ellipsoid, not above sea level")

    @property
    def point(self) -> Geodetic:
        """The point on the ellipsoid."""
        return Geodetic(self.latitude_deg, self.longitude_deg, self.altitude_m)


class FramesConfig(Section):
    """Names of the published frames (REP-105) and the datum."""

    world: str = Field("map", description="W: east, north, up at the datum")
    odometry: str = Field("odom", description="O: continuous, never jumps")
    base: str = Field(
        "base_link", description="B: the chassis; published if `extrinsics` or `turn_joint` join it to the IMU"
    )
    odometry_policy: Literal["always", "at_recovery"] = Field(
        "always", description="T_W_O takes every correction, or (the paper) only the one at the recovery of GNSS"
    )
    datum: Datum | None = Field(None, description="without it the first accepted fix is the datum")
    gravity: float | None = quantity("m/s^2", None, gt=9.7, lt=9.9, doc="without it WGS84 gravity at the datum")
