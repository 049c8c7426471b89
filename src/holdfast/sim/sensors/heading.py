"""Heading of a dual-antenna receiver."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field

from holdfast.config.section import quantity
from holdfast.messages import Array
from holdfast.sim.datasheets import Sheet
from holdfast.sim.effects import Event, overwritten
from holdfast.sim.readings import Readings, elapsed, slow_noise
from holdfast.sim.ros import ABSENT, NOTHING, Encode, RosMessages
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import SensorKind, register
from holdfast.sim.sensors.gnss import Antenna, OfReceiver, Quality, antenna_at, antennas_of, exchanged

MESSAGE = "sensor_msgs/msg/Imu"

FLOAT_RATIO = 10.0  # a float baseline is known to centimetres instead of millimetres


class SimulatedHeading(OfReceiver):
    """Heading of a dual-antenna receiver: yaw of the baseline from one antenna to another."""

    kind: Literal["heading"]
    baseline: tuple[str, str] | None = Field(None, description="from which antenna to which; by default the first two")
    white_rad: float = quantity("rad", 1.5e-3, ge=0, doc="sigma of the white part")
    slow_rad: float = quantity("rad", 8e-4, ge=0, doc="sigma of the slow part")
    time_constant_s: float = quantity("s", 60.0, gt=0, doc="the slow part decorrelates in this time")

    def antennas(self, present: Iterable[str]) -> tuple[str, ...]:
        """Return from which antenna to which it measures, of those present: fewer than two if there are fewer."""
        return self.baseline or tuple(present)[:2]


def mistakes(name: str, sheet: SimulatedHeading, sheets: Mapping[str, Sheet]) -> Iterator[str]:
    """Yield what is wrong with the baseline."""
    antennas = antennas_of(sheets)
    ends = sheet.antennas(antennas)
    if len(ends) < 2 or not set(ends) <= antennas.keys():
        yield f"sensors.{name}.baseline: needs two with `kind: gnss`, not {' and '.join(ends) or 'none'}"


def measure(at: Sampling) -> Readings:
    """Return the headings between its antennas, as `heading_readings`."""
    ends = at.sheet.antennas(antennas_of(at.scene.sheets))
    start, end = (antenna_at(at.scene, name, at.times_s) for name in ends)
    return heading_readings(at.sheet, start, end, at.rng)


def heading_readings(
    sheet: SimulatedHeading,
    start: Antenna,
    end: Antenna,
    rng: np.random.Generator,
) -> Readings:
    """Return the yaw of the horizontal projection of the baseline from one antenna to the other in W.

    There are no rows where an antenna is worse than float; where one is float, error and claim are ten times those of
    the datasheet.

    Args:
        sheet: of the receiver.
        start: antenna from which the baseline leads, at the times of measurement.
        end: antenna to which it leads, at the same times.
        rng: of this sensor.

    Columns:
        yaw_rad: (M,) within [-pi, pi], 0 is east, counter-clockwise.
        sigma_rad: (M,) claimed standard deviation.
    """
    times_s, worse = start.times_s, np.minimum(start.quality, end.quality)
    ratio = np.where(worse < Quality.RTK_FIXED, FLOAT_RATIO, 1.0)
    slow = slow_noise(rng, elapsed(times_s, sheet.time_constant_s))
    error = sheet.white_rad * rng.standard_normal(len(times_s)) + sheet.slow_rad * slow
    baseline = end.p_W - start.p_W
    columns = {
        "yaw_rad": wrapped_rad(np.arctan2(baseline[:, 1], baseline[:, 0]) + ratio * error),
        "sigma_rad": ratio * np.hypot(sheet.white_rad, sheet.slow_rad),
    }
    return Readings(times_s, columns).taken(worse >= Quality.RTK_FLOAT)


def wrapped_rad(angle_rad: Array) -> Array:
    """Return the same angles within [-pi, pi]."""
    return np.arctan2(np.sin(angle_rad), np.cos(angle_rad))


def reverse(event: Event, name: str) -> Readings:
    """Rotate by pi a heading between two antennas that are exchanged."""
    before, inside = event.readings[name], event.inside(name)
    sheet = event.sheets[name]
    if not isinstance(sheet, SimulatedHeading) or {*sheet.antennas(antennas_of(event.sheets))} != {*exchanged(event)}:
        return before
    return overwritten(before, inside, {"yaw_rad": wrapped_rad(before.values["yaw_rad"][inside] + np.pi)})


def encode(ros: RosMessages, sheet: SimulatedHeading, readings: Readings) -> Encode:
    """Return what makes the sensor_msgs/Imu of a heading, of whose orientation only the yaw is known."""
    half, sigmas = readings.values["yaw_rad"] / 2.0, readings.values["sigma_rad"]
    unknown = np.pi**2
    return lambda row, stamp_ns: ros.make(
        MESSAGE,
        header=ros.header(stamp_ns, sheet.frame),
        orientation=ros.quaternion((0.0, 0.0, np.sin(half[row]), np.cos(half[row]))),
        orientation_covariance=np.diag([unknown, unknown, sigmas[row] ** 2]).ravel(),
        angular_velocity=ros.vector(NOTHING),
        angular_velocity_covariance=ABSENT,
        linear_acceleration=ros.vector(NOTHING),
        linear_acceleration_covariance=ABSENT,
    )


def entry(sheet: SimulatedHeading) -> dict[str, Any]:
    """Return the baseline, where the datasheet names one."""
    return {} if sheet.baseline is None else {"baseline": list(sheet.baseline)}


register(
    SensorKind(
        SimulatedHeading,
        measure,
        MESSAGE,
        encode,
        entry,
        side_effects={"swap": reverse},
        mistakes=mistakes,
        gives_heading=True,
    )
)
