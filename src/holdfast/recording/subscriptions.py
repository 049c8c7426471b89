"""Which topics of a recording feed which sensors: what the configuration asks of a recording."""

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.recording.kinds import KINDS
from holdfast.recording.source import Subscription


def subscriptions(config: Config) -> list[Subscription]:
    """Return one subscription per sensor that has a topic, in the order of the file.

    Raises:
        ConfigError: a sensor is of a kind without a row in `holdfast.recording.kinds`.
    """
    found = []
    for name, section in config.sensors.items():
        if section.topic is None:
            continue
        if section.kind not in KINDS:
            raise ConfigError(f"sensors.{name}.kind: nothing is registered that decodes {section.kind}")
        joint_name = getattr(section, "joint_name", None)
        found.append(Subscription(section.topic, name, section.kind, joint_name))
    return found
