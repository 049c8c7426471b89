"""The kinds of simulated sensors: a file each, with datasheet, readings, ROS messages, configuration and faults.

All modules of this package are imported, in the order of their names, and register their kinds. A program registers
others in the same way, and needs to touch nothing else.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, ClassVar, TypeVar, get_args

from holdfast.config.section import OpenUnion, Section
from holdfast.sim.datasheets import Sheet
from holdfast.sim.effects import Effect
from holdfast.sim.readings import Readings
from holdfast.sim.ros import Encode, RosMessages
from holdfast.sim.scene import Measure

Model = TypeVar("Model", bound=Section)


@dataclass(frozen=True, slots=True)
class SensorKind:
    """One kind of sensor.

    Attributes:
        sheet: its datasheet, whose `kind` names it.
        measure: makes its readings; None where there is nothing to measure.
        message_type: of its messages in the recording.
        encode: returns what makes the message of a row and a stamp; without it none are written.
        entry: returns what the owner writes into the configuration beside kind, topic, frame and known clock offset;
            unused where the configuration does not know the kind.
        faults: effects of the faults that can happen to it, by their kind, beside those that happen to any sensor.
        side_effects: what faults of other sensors do to it, by their kind.
        mistakes: yields what is wrong with a datasheet, given its name and all datasheets by name.
        gives_heading: whether an owner with such a sensor needs no initial heading.
        example: name and datasheet of one on a shipped machine, for random schedules.
    """

    sheet: type[Sheet]
    measure: Measure | None = None
    message_type: str = ""
    encode: Callable[[RosMessages, Any, Readings], Encode] | None = None
    entry: Callable[[Any], dict[str, Any]] = lambda _sheet: {}
    faults: Mapping[str, Effect] = field(default_factory=dict)
    side_effects: Mapping[str, Effect] = field(default_factory=dict)
    mistakes: Callable[[str, Any, Mapping[str, Sheet]], Iterator[str]] = lambda _name, _sheet, _sheets: iter(())
    gives_heading: bool = False
    example: tuple[str, Mapping[str, Any]] | None = None


KINDS: dict[str, SensorKind] = {}
_SHEETS: dict[str, type[Section]] = {}
_MODELS: list[type[Section]] = []


def register(row: SensorKind) -> None:
    """Let scenarios name one more kind of sensor; to be configured, it must be a kind of the configuration as well."""
    kind = get_args(row.sheet.model_fields["kind"].annotation)[0]
    KINDS[kind], _SHEETS[kind] = row, row.sheet
    for model in _MODELS:
        model.model_rebuild(force=True)


def names_sensors(model: type[Model]) -> type[Model]:
    """Decorate a model that holds `AnySheet`, so that it accepts the kinds that are registered later."""
    _MODELS.append(model)
    return model


for _module in sorted(module.name for module in iter_modules(__path__)):
    import_module(f"{__name__}.{_module}")


class AnySheet(OpenUnion, Sheet):
    """A datasheet of any kind."""

    kinds: ClassVar[dict[str, type[Section]]] = _SHEETS
