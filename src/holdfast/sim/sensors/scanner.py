"""A lidar; `holdfast.sim.scans` casts its rays. The configuration has no such sensor."""

from typing import Literal

from pydantic import Field

from holdfast.config.section import quantity
from holdfast.sim.datasheets import SimulatedSensor
from holdfast.sim.readings import Readings
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import SensorKind, register


class SimulatedScanner(SimulatedSensor):
    """A lidar, whose scans are ray-cast where asked for: one column of `channels` rays at a time."""

    kind: Literal["scanner"]
    pattern: Literal["rings", "rosette"] = Field(
        "rings", description="a sensor that turns, or one that looks along x through two prisms that turn"
    )
    channels: int = Field(128, ge=1, le=256, description="rays per column")
    columns: int = Field(512, ge=16, le=4096, description="columns per sweep")
    field_of_view_deg: tuple[float, float] = Field(
        (-45.0, 45.0), description="lowest and highest ray [deg]; of a rosette, that of a cone"
    )
    min_range_m: float = quantity("m", 0.5, ge=0, doc="nearer returns are lost")
    max_range_m: float = quantity("m", 60.0, gt=0, doc="farther returns are lost")
    range_noise_m: float = quantity("m", 0.02, ge=0, doc="sigma of the range")
    dropout_ratio: float = quantity("1", 0.02, ge=0, lt=1, doc="fraction of returns that are lost")
    point_times: bool = Field(True, description="a field `t` tells when each point was measured")

    @property
    def ready_s(self) -> float:
        """The time of one sweep: it is sent when it is complete."""
        return 1.0 / self.rate_hz


def measure(at: Sampling) -> Readings:
    """Return the times of the sweeps, without columns."""
    return Readings(at.times_s, {})


register(SensorKind(SimulatedScanner, measure))
