"""From the configuration to the models of its sensors: every module of this room may register a kind."""

from importlib import import_module
from pkgutil import iter_modules

from holdfast import sensors
from holdfast.config.model import Config
from holdfast.config.sensors import BaseImuConfig, ImuConfig, JointConfig
from holdfast.errors import ConfigError, MessageError
from holdfast.measured_fields import no_message
from holdfast.messages import ImuSample, JointAngle, Message
from holdfast.sensors.sensor import MAKERS, Sensor

for _module in iter_modules(sensors.__path__):
    if _module.name != "registry":
        import_module(f"{sensors.__name__}.{_module.name}")


def sensors_of(config: Config) -> dict[str, Sensor]:
    """Return the sensors that go into the graph, by name; the IMU, and what serves the chassis, are none of them."""
    return {
        name: MAKERS[type(section)](name, section, config)
        for name, section in config.sensors.items()
        if type(section) in MAKERS
    }


def inputs_of(config: Config) -> dict[str, type[Message]]:
    """Return the sensors whose messages the graph needs, by name, and what they are.

    The encoder is one of them where a sensor sits beyond the turn joint.
    """
    found = sensors_of(config)
    inputs = {name: sensor.message for name, sensor in found.items() if sensor.message is not None}
    if config.joint is not None and any(config.is_beyond_joint(config.frame_of(name)) for name in found):
        inputs[config.joint[0]] = JointAngle
    return inputs


class MessageKinds:
    """Knows which messages each sensor of a configuration has."""

    def __init__(self, config: Config) -> None:
        self._names = frozenset(config.sensors)
        self._kinds: dict[str, type[Message]] = inputs_of(config)
        for name, section in config.sensors.items():
            if isinstance(section, ImuConfig | BaseImuConfig):
                self._kinds[name] = ImuSample
            elif isinstance(section, JointConfig):
                self._kinds[name] = JointAngle

    def check(self, message: Message) -> None:
        """Refuse a message that no sensor has, or another one than it says.

        Raises:
            ConfigError: the sensor is not in the configuration.
            MessageError: it is no message, or one of another kind.
        """
        name = getattr(message, "sensor", None)
        if not isinstance(name, str):
            raise no_message(message)
        if name not in self._names:
            raise ConfigError(f"sensors.{name}: not in the configuration, but a message of it came")
        kind = self._kinds.get(name)
        if kind is not None and not isinstance(message, kind):
            given = type(message).__name__
            raise MessageError(f"message: of sensor {name!r} must be of type {kind.__name__}, not {given}")
