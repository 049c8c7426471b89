"""From the configuration to the models of its sensors: every module of this room may register a kind."""

from importlib import import_module
from pkgutil import iter_modules

from holdfast import sensors
from holdfast.config.model import Config
from holdfast.messages import JointAngle, Message
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
