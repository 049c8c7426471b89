"""The kinds of sensors that a configuration may name: every section of `holdfast.config.sensors` that has one."""

from collections.abc import Iterator
from functools import cache
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, ClassVar, get_args

from holdfast.config import sensors
from holdfast.config.section import OpenUnion, Section
from holdfast.config.sensors import SensorConfig

PLUGINS = "holdfast.sensors"  # entry points of installed packages, modules that register kinds when they are imported


def kind_of(section: type[SensorConfig]) -> str:
    """Return the kind whose section this is."""
    name: str = get_args(section.model_fields["kind"].annotation)[0]
    return name


def _sections() -> Iterator[type[SensorConfig]]:
    for one in vars(sensors).values():
        if isinstance(one, type) and issubclass(one, SensorConfig) and get_args(one.model_fields["kind"].annotation):
            yield one


KINDS: dict[str, type[SensorConfig]] = {kind_of(section): section for section in _sections()}

if TYPE_CHECKING:
    AnySensor = SensorConfig
else:

    class AnySensor(OpenUnion, SensorConfig):
        """A sensor of any kind."""

        kinds: ClassVar[dict[str, type[Section]]] = KINDS


@cache
def load_plugins() -> None:
    """Import what installed packages offer as entry points `holdfast.sensors`, so that they register their kinds."""
    for plugin in entry_points(group=PLUGINS):
        plugin.load()
