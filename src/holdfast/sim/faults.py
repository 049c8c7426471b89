"""What goes wrong with measurements before they travel; `clock_step` is the work of the transport.

Faults happen in the order in which the scenario lists them, each to what those before it left. Nothing outside the
interval of a fault changes (both ends belong to it), except after a jump, which is for good.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from holdfast.errors import ConfigError
from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedGnss
from holdfast.sim.gnss import Antenna, Generators, Quality, fix_errors
from holdfast.sim.heading import wrapped_rad
from holdfast.sim.readings import Readings
from holdfast.sim.scenario import Fault

LOGGED = ("angular_velocity", "specific_force")  # other columns of an IMU are truth
SWAPPED = {"gnss": "gnss_right", "gnss_right": "gnss"}


def apply_faults(
    faults: Iterable[Fault],
    readings: Mapping[str, Readings],
    sheets: Mapping[str, SimulatedGnss],
    generators: Generators,
) -> dict[str, Readings]:
    """Return the readings of all sensors after all faults but `clock_step`.

    The column `lying` of a GNSS sensor becomes true where a fault moved a fix by more than one claimed sigma on any
    axis; `error` remains position minus truth.

    Args:
        faults: of the scenario; sensors without readings are passed over.
        readings: by sensor name.
        sheets: datasheets of the GNSS sensors.
        generators: random numbers by the names of their purpose.

    Raises:
        ConfigError: a swap without fixes of both antennas, or a line over all samples of an IMU.
    """
    result = dict(readings)
    for index, fault in enumerate(faults):
        if fault.kind == "clock_step":
            continue
        # an exchange concerns both antennas and their heading, whomever the fault names
        names = (*SWAPPED, "heading") if fault.kind == "swap" else fault.sensors
        event = _Event(fault, dict(result), sheets, partial(generators, "fault", str(index)))
        result |= {name: EFFECTS[fault.kind](event, name) for name in names if name in result}
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Event:
    """One fault, and what was measured before it strikes."""

    fault: Fault
    readings: Mapping[str, Readings]
    sheets: Mapping[str, SimulatedGnss]
    generators: Generators

    def inside(self, name: str) -> NDArray[np.bool_]:
        """Tell which rows (N,) of a sensor the fault's interval holds."""
        times_s = self.readings[name].times_s
        return (times_s >= self.fault.start_s) & (times_s <= self.fault.end_s)

    def elapsed_s(self, name: str) -> Array:
        """Return the time (N, 1) since the fault's start, 0 outside the interval."""
        return np.where(self.inside(name), self.readings[name].times_s - self.fault.start_s, 0.0)[:, None]


def _outage(event: _Event, name: str) -> Readings:
    """Remove the rows; or let a fix wander off at a constant random velocity, as float, with a claim that covers it.

    The antennas share as much of the velocity as of their slow error. A heading is always removed.
    """
    growth, sheet = event.fault.claim_growth_m_s, event.sheets.get(name)
    if growth is None or sheet is None:
        return _silence(event, name)
    before = event.readings[name]
    claim = growth * event.elapsed_s(name)
    common, own = (event.generators(purpose).standard_normal(3) for purpose in ("shared error", name))
    course = np.sqrt(sheet.shared_ratio) * common + np.sqrt(1.0 - sheet.shared_ratio) * own
    quality = before.values["quality"]
    return before.replaced(
        position=before.values["position"] + claim / sheet.claim_ratio * course,
        error=before.values["error"] + claim / sheet.claim_ratio * course,
        sigma=np.hypot(before.values["sigma"], claim),
        quality=np.where(event.inside(name), np.minimum(quality, Quality.RTK_FLOAT), quality),
    )


def _degraded(event: _Event, name: str) -> Readings:
    """Draw the errors of better fixes anew from the lower quality, for both antennas of the fault together."""
    quality = int(Quality[event.fault.quality.upper()])
    antennas: dict[str, Antenna] = {}
    rows: dict[str, NDArray[np.bool_]] = {}
    for sensor in (sensor for sensor in event.fault.sensors if sensor in event.readings):
        readings = event.readings[sensor]
        rows[sensor] = event.inside(sensor) & (readings.values["quality"] > quality)
        fixes = readings.taken(rows[sensor])
        qualities = np.full(len(fixes.times_s), quality)
        antennas[sensor] = Antenna(event.sheets[sensor], fixes.times_s, fixes.values["truth"], qualities)
    error, sigma = fix_errors(antennas, event.generators)[name]
    fresh = {
        "position": antennas[name].p_W + error,
        "error": error,
        "sigma": sigma,
        "quality": antennas[name].quality,
        "lying": np.zeros(len(error), dtype=bool),
    }
    return _overwritten(event.readings[name], rows[name], fresh)


def _walk(event: _Event, name: str) -> Readings:
    offset = np.array(event.fault.offset_m)
    share = event.fault.rate_m_s * event.elapsed_s(name) / (float(np.linalg.norm(offset)) or 1.0)
    return _lied(event.readings[name], np.minimum(share, 1.0) * offset)


def _offset(event: _Event, name: str) -> Readings:
    return _lied(event.readings[name], event.inside(name)[:, None] * np.array(event.fault.offset_m))


def _spikes(event: _Event, name: str) -> Readings:
    """Move the first fix of every period by the offset, turned about the vertical."""
    before, inside = event.readings[name], event.inside(name)
    period = np.floor(event.elapsed_s(name)[:, 0] / event.fault.period_s)
    period[~inside] = -1.0
    first = inside & (np.diff(period, prepend=-1.0) > 0.0)
    turns = event.generators(name).uniform(-np.pi, np.pi, (int(first.sum()), 1))
    shift = np.zeros_like(before.values["position"])
    shift[first] = Rotation.from_euler("z", turns).apply(event.fault.offset_m)
    return _lied(before, shift)


def _swap(event: _Event, name: str) -> Readings:
    """Give each antenna the other's fix of the nearest time; the heading turns by pi."""
    before, inside = event.readings[name], event.inside(name)
    if any(sensor not in event.readings or not len(event.readings[sensor].times_s) for sensor in SWAPPED):
        raise ConfigError(f"faults: a swap at {event.fault.start_s:g} s needs fixes of {' and '.join(SWAPPED)}")
    if name == "heading":
        return _overwritten(before, inside, {"yaw_rad": wrapped_rad(before.values["yaw_rad"][inside] + np.pi)})
    other = event.readings[SWAPPED[name]]
    middle_s = (other.times_s[1:] + other.times_s[:-1]) / 2.0
    fixes = other.taken(np.searchsorted(middle_s, before.times_s[inside])).values
    fresh = {column: fixes[column] for column in ("sigma", "quality")}
    shift = np.zeros_like(before.values["position"])
    shift[inside] = fixes["position"] - before.values["position"][inside]
    return _lied(_overwritten(before, inside, fresh), shift)


def _silence(event: _Event, name: str) -> Readings:
    return event.readings[name].taken(~event.inside(name))


def _line(event: _Event, name: str) -> Readings:
    """Draw lines between the last sample before and the first one after; at an end of the recording, level ones."""
    before, inside = event.readings[name], event.inside(name)
    if inside.all():
        raise ConfigError(f"faults: the line at {event.fault.start_s:g} s leaves no sample of {name} to start from")
    lines = {}
    for column in LOGGED:
        axes = before.values[column].T
        drawn = [np.interp(before.times_s[inside], before.times_s[~inside], axis[~inside]) for axis in axes]
        lines[column] = np.stack(drawn, axis=1)
    return _overwritten(before, inside, lines)


def _jump(event: _Event, name: str) -> Readings:
    """Shift the first pose by the offset and turn it about z, in its own frame, and carry on from there.

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
    return _overwritten(before, rows, jumped)


def _freeze(event: _Event, name: str) -> Readings:
    before, inside = event.readings[name], event.inside(name)
    return _overwritten(before, inside, {"angle_rad": before.values["angle_rad"][inside][:1]})


def _lied(before: Readings, shift: Array) -> Readings:
    """Move the fixes by `shift` (N, 3) [m] and mark those of which the claim knows nothing."""
    known = np.abs(shift) <= before.values["sigma"]
    lying = ~known.all(axis=1) & (before.values["quality"] > Quality.NONE)
    return before.replaced(
        position=before.values["position"] + shift,
        error=before.values["error"] + shift,
        lying=before.values["lying"] | lying,
    )


def _overwritten(before: Readings, rows: NDArray[np.bool_], fresh: Mapping[str, NDArray[np.generic]]) -> Readings:
    """Return the readings with other values of some columns in some rows."""
    columns = {name: before.values[name].copy() for name in fresh}
    for name, values in fresh.items():
        columns[name][rows] = values
    return before.replaced(**columns)


EFFECTS: dict[str, Callable[[_Event, str], Readings]] = {
    "outage": _outage,
    "degraded": _degraded,
    "walk": _walk,
    "offset": _offset,
    "spikes": _spikes,
    "swap": _swap,
    "silence": _silence,
    "line": _line,
    "jump": _jump,
    "freeze": _freeze,
}
