"""Something that goes wrong in a scenario."""

from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from holdfast.config.section import Section, Vector3, quantity
from holdfast.messages import Array

FaultKind = Literal[
    "outage",
    "degraded",
    "walk",
    "offset",
    "spikes",
    "swap",
    "silence",
    "line",
    "jump",
    "freeze",
    "slip",
    "clock_step",
    "flood",
    "twin",
    "garbage",
]


class Fault(Section):
    """Something that goes wrong for a while; which kinds of sensors it can happen to stands in their files.

    outage: no messages, or fixes of GNSS that wander off with a claim that grows (`claim_growth_m_s`).
    degraded: the fix falls to float or single (`quality`), honestly reported.
    walk: multipath moves the position away at `rate_m_s` along `offset_m`, up to its length; its claim does not grow.
    offset: the position is `offset_m` away, as by a wrong integer; its claim does not grow.
    spikes: every `period_s` one position is off by `offset_m`, rotated at random; its claim does not grow.
    swap: two antennas' fixes are exchanged, or the station follows another prism, `offset_m` away.
    silence: no messages. line: the logger drew straight lines over missing IMU samples.
    jump: the frame of the poses jumps by `offset_m` and `yaw_deg` for good. freeze: the sensor repeats itself.
    slip: the wheels spin, the velocity is `slip_ratio` of itself and `slip_m_s` too much.
    clock_step: stamps step by `step_s`, until the end of the interval.
    flood: every reading is repeated at `flood_hz` until the next one, with fresh stamps.
    twin: a second publisher sends every message too, with a stamp off by `step_s` and content `behind` messages old.
    garbage: in a fraction `garbage_ratio` of the messages numbers, covariances or the stamp mean nothing.
    """

    kind: FaultKind
    sensors: tuple[str, ...] = Field(min_length=1, description="whose messages suffer")
    start_s: float = quantity("s", ge=0, doc="since the start of the scenario")
    end_s: float = quantity("s", ge=0, doc="since the start of the scenario")
    quality: Literal["rtk_float", "single"] = Field("rtk_float", description="for degraded")
    offset_m: Vector3 = quantity(
        "m", (1.0, 0.0, 0.0), doc="for walk, offset, spikes, swap (east, north, up), jump (in the sensor's frame)"
    )
    yaw_deg: float = quantity("deg", 0.0, doc="for jump")
    rate_m_s: float = quantity("m/s", 0.05, gt=0, doc="for walk")
    period_s: float = quantity("s", 5.0, gt=0, doc="for spikes")
    claim_growth_m_s: float | None = quantity("m/s", None, gt=0, doc="for outage: sigma grows so fast; else silence")
    slip_ratio: float = quantity("1", 0.0, ge=-1, le=10, doc="for slip: of the velocity along x")
    slip_m_s: float = quantity("m/s", 0.0, ge=-10, le=10, doc="for slip: along x")
    step_s: float = quantity("s", 0.0, ge=-1.6e9, le=5e8, doc="for clock_step and twin: from 1970 to 2036")
    flood_hz: float = quantity("Hz", 1000.0, gt=0, le=10_000, doc="for flood")
    behind: int = Field(0, ge=0, le=100, description="for twin: messages")
    garbage_ratio: float = quantity("1", 1.0, ge=0, le=1, doc="for garbage: of the messages")

    def holds(self, times_s: Array) -> NDArray[np.bool_]:
        """Return which times (N,) since the start of the scenario [s] lie inside; both ends belong to it."""
        inside: NDArray[np.bool_] = (times_s >= self.start_s) & (times_s <= self.end_s)
        return inside

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.end_s < self.start_s:
            raise ValueError(f"end_s: {self.end_s:g} lies before start_s {self.start_s:g}")
        return self
