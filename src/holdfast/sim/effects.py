"""Effects of faults: what they do to the readings of a sensor.

Those of one kind of sensor alone stand in its file. Nothing outside the interval of a fault changes (both ends belong
to it), except after a jump, which is for good.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from holdfast.messages import Array
from holdfast.sim.datasheets import Sheet
from holdfast.sim.fault import Fault
from holdfast.sim.readings import Generators, Readings

NO_FIX = 0
"""Lowest quality, of a position that nobody may use."""


@dataclass(frozen=True, slots=True, eq=False)
class Event:
    """One fault, and what was measured before it strikes."""

    fault: Fault
    readings: Mapping[str, Readings]
    sheets: Mapping[str, Sheet]
    generators: Generators

    def inside(self, name: str) -> NDArray[np.bool_]:
        """Return which rows (N,) of a sensor the fault's interval holds."""
        return self.fault.holds(self.readings[name].times_s)

    def elapsed_s(self, name: str) -> Array:
        """Return the time (N, 1) since the fault's start, 0 outside the interval."""
        return np.where(self.inside(name), self.readings[name].times_s - self.fault.start_s, 0.0)[:, None]


Effect = Callable[[Event, str], Readings]
"""Returns the readings that a sensor, given by its name, has after the fault."""


def unchanged(event: Event, name: str) -> Readings:
    """Leave the readings as they are: the fault strikes later, in transport or in the message."""
    return event.readings[name]


def silence(event: Event, name: str) -> Readings:
    """Remove the rows."""
    return event.readings[name].taken(~event.inside(name))


def flood(event: Event, name: str) -> Readings:
    """Repeat every row until the next one is due, at the rate of the flood and as if it were measured then."""
    before, inside = event.readings[name], event.inside(name)
    periods_s = np.diff(before.times_s, append=np.inf)
    finite = periods_s[np.isfinite(periods_s)]
    periods_s[-1:] = np.median(finite) if len(finite) else 0.0
    counts = np.where(inside, np.maximum(1, np.ceil(periods_s * event.fault.flood_hz - 1e-6)), 1).astype(np.int64)
    rows = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    repeated = before.taken(rows)
    return replace(repeated, times_s=repeated.times_s + number / event.fault.flood_hz)


def walk(event: Event, name: str) -> Readings:
    """Move the position along the offset at a constant speed, up to its length."""
    end_m = np.array(event.fault.offset_m)
    fraction = event.fault.rate_m_s * event.elapsed_s(name) / (float(np.linalg.norm(end_m)) or 1.0)
    return shifted(event.readings[name], np.minimum(fraction, 1.0) * end_m)


def offset(event: Event, name: str) -> Readings:
    """Move the position by the offset."""
    return shifted(event.readings[name], event.inside(name)[:, None] * np.array(event.fault.offset_m))


def spikes(event: Event, name: str) -> Readings:
    """Move the first position of every period by the offset, rotated about the vertical."""
    before, inside = event.readings[name], event.inside(name)
    period = np.floor(event.elapsed_s(name)[:, 0] / event.fault.period_s)
    period[~inside] = -1.0
    first = inside & (np.diff(period, prepend=-1.0) > 0.0)
    yaws = event.generators(name).uniform(-np.pi, np.pi, (int(first.sum()), 1))
    shift = np.zeros_like(before.values["position"])
    shift[first] = Rotation.from_euler("z", yaws).apply(event.fault.offset_m)
    return shifted(before, shift)


def jump(event: Event, name: str) -> Readings:
    """Shift the first pose by the offset and rotate it about z, in its own frame, and carry on from there.

    With J the jump in L and T_k the first pose: T_m becomes T_k J T_k^-1 T_m, so that all later relative motion is
    right.
    """
    before = event.readings[name]
    rows = before.times_s >= event.fault.start_s
    if not rows.any():
        return before
    position, attitude = before.values["position"][rows], Rotation.from_quat(before.values["quaternion"][rows])
    R_jump = attitude[0] * Rotation.from_euler("z", event.fault.yaw_deg, degrees=True) * attitude[0].inv()
    jumped = {
        "position": position[0] + attitude[0].apply(event.fault.offset_m) + R_jump.apply(position - position[0]),
        "quaternion": (R_jump * attitude).as_quat(),
    }
    return overwritten(before, rows, jumped)


def freezing(*columns: str) -> Effect:
    """Return the effect that repeats the first values of these columns."""

    def freeze(event: Event, name: str) -> Readings:
        before, inside = event.readings[name], event.inside(name)
        return overwritten(before, inside, {column: before.values[column][inside][:1] for column in columns})

    return freeze


def shifted(before: Readings, shift: Array) -> Readings:
    """Move positions by `shift` (N, 3) [m]; where errors are known, mark those beyond the claim."""
    columns: dict[str, NDArray[Any]] = {"position": before.values["position"] + shift}
    if "faulty" in before.values:
        unclaimed = (np.abs(shift) > before.values["sigma"]).any(axis=1)
        is_position = before.values["quality"] > NO_FIX if "quality" in before.values else True
        columns["error"] = before.values["error"] + shift
        columns["faulty"] = before.values["faulty"] | (unclaimed & is_position)
    return before.replaced(**columns)


def overwritten(before: Readings, rows: NDArray[np.bool_], fresh: Mapping[str, NDArray[np.generic]]) -> Readings:
    """Return the readings with other values of some columns in some rows."""
    columns = {name: before.values[name].copy() for name in fresh}
    for name, values in fresh.items():
        columns[name][rows] = values
    return before.replaced(**columns)


COMMON: Mapping[str, Effect] = {
    "outage": silence,
    "silence": silence,
    "flood": flood,
    "clock_step": unchanged,
    "twin": unchanged,
    "garbage": unchanged,
}
"""Effects of the faults that can happen to any sensor."""
