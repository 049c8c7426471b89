"""Positions of a prism that a robotic total station follows."""

from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from holdfast.config.section import Vector3, quantity
from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedSensor, positive
from holdfast.sim.effects import offset, spikes, walk
from holdfast.sim.readings import Readings
from holdfast.sim.ros import POINT, Encode, RosMessages
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import SensorKind, register

NEAREST_M = 0.1  # nearer than this a station measures no direction


class SimulatedPrism(SimulatedSensor):
    """A prism on the machine that a robotic total station follows.

    The defaults are those of a Leica TS16 that tracks: 3 mm + 1.5 ppm of range, 5 arc seconds, 10 Hz.
    """

    kind: Literal["prism"]
    station_m: Vector3 = quantity("m", doc="where the station stands in W")
    range_noise_m: float = quantity("m", 3e-3, ge=0, doc="sigma of the range, whatever it is")
    range_noise_ppm: float = quantity("ppm", 1.5, ge=0, doc="sigma in proportion to the range, added to it")
    angle_noise_rad: float = quantity("rad", 2.4e-5, ge=0, doc="sigma of the direction, per axis")
    latency_s: float = quantity("s", 0.01, ge=0, le=10, doc="by which a measurement is older than its stamp")
    grid_position_m: Vector3 = quantity("m", (0.0, 0.0, 0.0), doc="origin of the station's site grid in W")
    grid_yaw_deg: float = quantity("deg", 0.0, ge=-360, le=360, doc="of the site grid's x axis in W: 0 is east")


def measure(at: Sampling) -> Readings:
    """Return the positions of a prism: errors of range along the line of sight, of the direction across it.

    With the range d, sigma is range_noise + range_noise_ppm d along, angle_noise d across.

    Columns:
        position: (N, 3) of the prism in W [m].
        error: (N, 3) position minus truth [m].
        sigma: (N, 3) standard deviation per axis of W [m].
        faulty: (N,) whether a fault moved the position by more than sigma; here nowhere.
    """
    sheet: SimulatedPrism = at.sheet
    p_W = at.scene.motion.frame(sheet.frame, np.maximum(at.times_s - sheet.latency_s, 0.0)).p_W
    sight = p_W - np.array(sheet.station_m)
    range_m = np.linalg.norm(sight, axis=1, keepdims=True).clip(NEAREST_M)
    along = sight / range_m
    noise = at.rng.standard_normal(p_W.shape)
    radial = np.sum(noise * along, axis=1, keepdims=True) * along
    sigma_range_m = sheet.range_noise_m + sheet.range_noise_ppm * 1e-6 * range_m
    sigma_across_m = sheet.angle_noise_rad * range_m
    error = sigma_range_m * radial + sigma_across_m * (noise - radial)
    columns = {
        "position": p_W + error,
        "error": error,
        "sigma": np.sqrt((sigma_range_m * along) ** 2 + sigma_across_m**2 * (1.0 - along**2)),
        "faulty": np.zeros(len(at.times_s), dtype=bool),
    }
    return Readings(at.times_s, columns)


def in_grid(sheet: SimulatedPrism, p_W: Array) -> Array:
    """Return positions (N, 3) in W as the station reports them, in its site grid [m]."""
    grid = Rotation.from_euler("z", sheet.grid_yaw_deg, degrees=True)
    return np.asarray(grid.inv().apply(p_W - np.array(sheet.grid_position_m)))


def encode(ros: RosMessages, sheet: SimulatedPrism, readings: Readings) -> Encode:
    """Return what makes the geometry_msgs/PointStamped of a position in the station's grid."""
    return ros.points("site_grid", in_grid(sheet, readings.values["position"]))


def entry(sheet: SimulatedPrism) -> dict[str, Any]:
    """Return what the datasheet says, not its true errors."""
    grid = {"grid_position_m": list(sheet.grid_position_m), "grid_yaw_deg": sheet.grid_yaw_deg}
    return grid | {"latency_s": sheet.latency_s} | positive(sigma_m=sheet.range_noise_m)


FAULTS = {"walk": walk, "offset": offset, "spikes": spikes, "swap": offset}
EXAMPLE = ("prism", {"frame": "lidar", "rate_hz": 10, "topic": "/prism", "station_m": [30.0, -20.0, 2.0]})
register(SensorKind(SimulatedPrism, measure, POINT, encode, entry, faults=FAULTS, example=EXAMPLE))
