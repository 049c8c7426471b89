"""The encoder of the cabin's turn joint."""

from math import degrees, hypot, sqrt
from typing import Any, Literal

import numpy as np
from pydantic import Field

from holdfast.config.section import quantity
from holdfast.sim.datasheets import SimulatedSensor, positive
from holdfast.sim.effects import freezing
from holdfast.sim.readings import Readings, quantised
from holdfast.sim.ros import Encode, RosMessages
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import SensorKind, register

MESSAGE = "sensor_msgs/msg/JointState"


class SimulatedJoint(SimulatedSensor):
    """Encoder of the cabin's turn joint."""

    kind: Literal["joint"]
    joint_name: str = Field("cabin_turn", description="name in JointState")
    bias_sigma_rad: float = quantity("rad", 2e-3, ge=0, doc="zero offset of the mounting")
    noise_rad: float = quantity("rad", 2e-4, ge=0, doc="sigma of the white part")
    resolution_rad: float = quantity("rad", 3.83e-4, ge=0, doc="readings are multiples of it: 14 bits a revolution")


def measure(at: Sampling) -> Readings:
    """Return what the encoder measures.

    reading = angle + zero offset + white noise, rounded to the resolution. The angle is not wrapped: that of a
    cabin that goes on rotating grows beyond half a revolution.

    Columns:
        angle_rad: (N,) as measured.

    Constants:
        zero_offset_rad: by which every angle is too large.
    """
    sheet: SimulatedJoint = at.sheet
    angles_rad, _ = at.scene.motion.joint(at.times_s)
    offset_rad = sheet.bias_sigma_rad * float(at.rng.standard_normal())
    noise_rad = sheet.noise_rad * at.rng.standard_normal(len(angles_rad))
    measured = quantised(angles_rad + offset_rad + noise_rad, sheet.resolution_rad)
    return Readings(at.times_s, {"angle_rad": measured}, {"zero_offset_rad": offset_rad})


def encode(ros: RosMessages, sheet: SimulatedJoint, readings: Readings) -> Encode:
    """Return what makes a sensor_msgs/JointState."""
    angles, nothing = readings.values["angle_rad"], np.zeros(0)
    return lambda row, stamp_ns: ros.make(
        MESSAGE,
        header=ros.header(stamp_ns, sheet.frame),
        name=[sheet.joint_name],
        position=angles[row : row + 1],
        velocity=nothing,
        effort=nothing,
    )


def entry(sheet: SimulatedJoint) -> dict[str, Any]:
    """Return noise and step of the encoder and how well it was mounted, not its true zero."""
    noise_rad = hypot(sheet.noise_rad, sheet.resolution_rad / sqrt(12.0))
    known = positive(noise_deg=degrees(noise_rad), zero_offset_sigma_deg=degrees(sheet.bias_sigma_rad))
    return {"joint_name": sheet.joint_name, **known}


register(SensorKind(SimulatedJoint, measure, MESSAGE, encode, entry, faults={"freeze": freezing("angle_rad")}))
