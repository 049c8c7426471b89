"""Height of a point of the machine, as of a laser receiver on a mast."""

from math import hypot
from typing import Any, Literal

import numpy as np

from holdfast.config.section import quantity
from holdfast.sim.datasheets import SimulatedSensor, correlation_s, positive
from holdfast.sim.readings import Readings, elapsed, slow_noise
from holdfast.sim.ros import POINT, WORLD, Encode, RosMessages
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import SensorKind, register


class SimulatedHeight(SimulatedSensor):
    """Height of its frame, such as that of a laser receiver on a mast."""

    kind: Literal["height"]
    noise_m: float = quantity("m", 5e-3, ge=0, doc="sigma of the white part")
    slow_m: float = quantity("m", 3e-3, ge=0, doc="sigma of the slow part")
    time_constant_s: float = quantity("s", 60.0, gt=0, doc="the slow part decorrelates in this time")
    offset_m: float = quantity("m", 0.0, doc="of its zero in W; the owner knows the size only")


def measure(at: Sampling) -> Readings:
    """Return heights: truth, minus the zero of the sensor in W, plus white and slow noise.

    Columns:
        height_m: (N,) as measured.
    """
    sheet, moving, times_s, rng = at.sheet, at.moving, at.times_s, at.rng
    noise = sheet.noise_m * rng.standard_normal(len(times_s))
    slow = sheet.slow_m * slow_noise(rng, elapsed(times_s, sheet.time_constant_s))
    return Readings(times_s, {"height_m": moving.p_W[:, 2] - sheet.offset_m + noise + slow})


def encode(ros: RosMessages, _sheet: SimulatedHeight, readings: Readings) -> Encode:
    """Return what makes the geometry_msgs/PointStamped of a height, its x and y zero."""
    heights_m = readings.values["height_m"]
    return ros.points(WORLD, np.stack([0.0 * heights_m, 0.0 * heights_m, heights_m], axis=1))


def entry(sheet: SimulatedHeight) -> dict[str, Any]:
    """Return what the datasheet says, not its true errors."""
    return positive(
        sigma_m=hypot(sheet.noise_m, sheet.slow_m),
        offset_sigma_m=abs(sheet.offset_m),
        correlation_s=correlation_s(sheet.noise_m, sheet.slow_m, sheet.time_constant_s),
    )


EXAMPLE = ("mast", {"frame": "lidar", "rate_hz": 10, "topic": "/mast"})
register(SensorKind(SimulatedHeight, measure, POINT, encode, entry, example=EXAMPLE))
