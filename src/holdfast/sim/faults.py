"""What goes wrong with measurements before they travel.

Faults happen in the order in which the scenario lists them, each to what those before it left.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import get_args

from holdfast.sim.datasheets import Sheet
from holdfast.sim.effects import COMMON, Effect, Event
from holdfast.sim.fault import Fault, FaultKind
from holdfast.sim.readings import Generators, Readings
from holdfast.sim.sensors import KINDS

ANY = "any"
FAULTS: tuple[str, ...] = get_args(FaultKind)


def can_happen(fault: str, kind: str) -> bool:
    """Whether a fault can happen to a kind of sensor."""
    return fault in COMMON or fault in KINDS[kind].faults


def affected_kinds(fault: str) -> tuple[str, ...]:
    """Return the kinds of sensors to which a fault can happen; `ANY` alone if it can happen to all."""
    return (ANY,) if fault in COMMON else tuple(kind for kind, row in KINDS.items() if fault in row.faults)


def apply_faults(
    faults: Iterable[Fault],
    readings: Mapping[str, Readings],
    sheets: Mapping[str, Sheet],
    generators: Generators,
) -> dict[str, Readings]:
    """Return the readings of all sensors after all faults.

    The column `faulty` of a position becomes true where a fault moved it by more than one claimed sigma on any
    axis; `error` remains position minus truth.

    Args:
        faults: of the scenario; sensors without readings are passed over.
        readings: by sensor name.
        sheets: datasheets of the sensors.
        generators: random numbers by the names of their purpose.

    Raises:
        ConfigError: a swap without fixes of both antennas, or a line over all samples of an IMU.
    """
    result = dict(readings)
    for index, fault in enumerate(faults):
        event = Event(fault, dict(result), sheets, partial(generators, "fault", str(index)))
        result |= {name: effect(event, name) for name, effect in effects(fault, sheets) if name in result}
    return result


def effects(fault: Fault, sheets: Mapping[str, Sheet]) -> Iterator[tuple[str, Effect]]:
    """Yield the sensors that suffer by a fault, each with what happens to it."""
    for name, sheet in sheets.items():
        row = KINDS[sheet.kind]
        if name in fault.sensors:
            yield name, row.faults.get(fault.kind) or COMMON[fault.kind]
        elif fault.kind in row.side_effects:
            yield name, row.side_effects[fault.kind]
