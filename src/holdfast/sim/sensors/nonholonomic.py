"""A machine whose wheels do not slip: known to its owner, measured by nothing."""

from typing import Literal

from pydantic import Field

from holdfast.sim.datasheets import Sheet
from holdfast.sim.sensors import SensorKind, register


class SimulatedNonholonomic(Sheet):
    """No sensor, but a constraint that the owner knows, for wheels that slip neither sideways nor off the ground."""

    kind: Literal["nonholonomic"]
    frame: str = Field("base_link", min_length=1, description="of the axle that does not steer")


register(SensorKind(SimulatedNonholonomic))
