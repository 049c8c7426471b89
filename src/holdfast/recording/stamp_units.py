"""Stamps of text files that are in another unit than nanoseconds: their pace says so, or what lies beside them."""

from collections.abc import Sequence
from typing import NamedTuple

from holdfast.errors import RecordingError

NS_PER_UNIT = {"microseconds": 1_000, "milliseconds": 1_000_000, "seconds": 1_000_000_000}
FASTEST_NS = 100_000  # no sensor measures 10,000 times a second
USUAL_NS = 1_000_000  # between two samples of a fast IMU
BESIDE_NS = 3_600_000_000_000  # files of one folder were recorded together
YEARS_NS = range(946_684_800_000_000_000, 4_102_444_800_000_000_000)  # 2000 to 2100


class Stamps(NamedTuple):
    """A column of times of a file.

    Attributes:
        pace: mean step over the first lines, None where there are too few.
    """

    file: str
    column: str
    first: int
    last: int
    pace: float | None


def check_units(columns: Sequence[Stamps]) -> None:
    """Refuse columns that are in another unit.

    Raises:
        RecordingError: names each file, its columns and the unit, one line each.
    """
    wrong: dict[tuple[str, str], list[Stamps]] = {}
    for one in columns:
        unit = _unit_beside(one, columns) or _unit_of_pace(one)
        if unit is not None:
            wrong.setdefault((one.file, unit), []).append(one)
    if wrong:
        raise RecordingError("\n".join(_fault(file, unit, found) for (file, unit), found in wrong.items()))


def _fault(file: str, unit: str, found: Sequence[Stamps]) -> str:
    names, verb = " and ".join(one.column for one in found), "looks like" if len(found) == 1 else "look like"
    must_be = f"must be nanoseconds, {NS_PER_UNIT[unit]:,} times as many"
    return f"{file}: {names} {verb} {unit}, from {found[0].first} to {found[0].last}: {must_be}"


def _unit_beside(one: Stamps, columns: Sequence[Stamps]) -> str | None:
    """Return the unit in which a column lies beside one that counts from the epoch."""
    units = (unit for unit, ns in NS_PER_UNIT.items() if any(_are_beside(one, other, ns) for other in columns))
    return next(units, None)


def _are_beside(one: Stamps, other: Stamps, ns: int) -> bool:
    is_within = other.first - BESIDE_NS <= one.first * ns and one.last * ns <= other.last + BESIDE_NS
    return is_within and other.first in YEARS_NS


def _unit_of_pace(one: Stamps) -> str | None:
    """Return the unit of steps that are too short: in which they begin in our time, or else are those of a sensor."""
    if one.pace is None or not 0.0 < one.pace < FASTEST_NS:
        return None
    ours = [unit for unit, ns in NS_PER_UNIT.items() if one.first * ns in YEARS_NS]
    usual = [unit for unit, ns in NS_PER_UNIT.items() if one.pace * ns >= USUAL_NS]
    return next(iter(ours + usual), None)
