"""What moves before the lidar, as keys of a scenario: the body and the arm of the machine, people and trucks."""

from typing import Literal

from pydantic import Field

from holdfast.config.section import Section, Vector3, quantity


class Part(Section):
    """A part of the machine that the lidar sees: a box in one of the machine's frames."""

    frame: str = Field("cabin", description="`cabin` or `base_link`")
    center_m: Vector3 = quantity("m", doc="its middle in the frame")
    size_m: Vector3 = quantity("m", doc="length, width, height")


class Arm(Section):
    """Boom, stick and bucket; each is a box as long as its link."""

    pivot_m: Vector3 = quantity("m", (0.8, -0.25, 0.4), doc="of the boom, in the cabin")
    lengths_m: Vector3 = quantity("m", (3.6, 2.4, 1.1), doc="of boom, stick and bucket")
    widths_m: Vector3 = quantity("m", (0.35, 0.28, 1.2), doc="across the plane of the arm")
    heights_m: Vector3 = quantity("m", (0.4, 0.32, 0.6), doc="in the plane of the arm")


class Mover(Section):
    """Somebody or something that moves over the ground: to the end of the path, back, and so on."""

    kind: Literal["person", "truck", "box"] = Field("person", description="its shape; a `box` has `size_m`")
    size_m: Vector3 = quantity("m", (1.0, 1.0, 1.0), doc="length, width, height of a box")
    path_m: tuple[tuple[float, float], ...] = Field(min_length=2, description="waypoints, east and north [m]")
    speed_m_s: float = quantity("m/s", 1.3, gt=0, le=20, doc="along the path")
    start_s: float = quantity("s", 0.0, ge=0, doc="it waits at the first waypoint until then")
    wait_s: float = quantity("s", 2.0, ge=0, doc="it waits up to so long at a waypoint")
