"""Which topics of a recording feed which sensors: what the configuration asks of a recording."""

from collections.abc import Sequence
from difflib import get_close_matches

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.recording.kinds import KINDS
from holdfast.recording.source import Recording, Subscription, find_topic
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import Role


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
        joint_name, factors = (getattr(section, key, None) for key in ("joint_name", "factors"))
        found.append(Subscription(section.topic, name, section.kind, joint_name, factors))
    return found


def available(recording: Recording, config: Config) -> tuple[list[Subscription], dict[str, str]]:
    """Return the subscriptions that a recording can serve, and why the other sensors are missing, by name.

    Needed is the primary IMU, and of all sensors that can tell a position at least one.

    Raises:
        RecordingError: what is needed is absent; as `find_topic` says it.
        ConfigError: as `subscriptions`.
    """
    wanted = subscriptions(config)
    counts = {info.topic: info.count for info in recording.topics}
    absent = [one for one in wanted if one.topic not in counts]
    for one in _needed(config, wanted, absent):
        find_topic(recording, one.topic)
    missing = {one.sensor: _reason(recording, one.topic) for one in absent}
    served = [one for one in wanted if one not in absent]
    empty = [one for one in served if counts[one.topic] == 0]
    needed = _needed(config, wanted, [*absent, *empty])  # what is needed and empty, the estimator will name
    missing |= {one.sensor: f"topic {one.topic!r} holds no message" for one in empty if one not in needed}
    return served, missing


def _needed(config: Config, wanted: Sequence[Subscription], absent: Sequence[Subscription]) -> list[Subscription]:
    """Return which of the absent ones the estimator cannot start without."""
    roles = {name: sensor.role for name, sensor in sensors_of(config).items()}
    points = [one for one in wanted if roles.get(one.sensor) in (Role.POSITION, Role.POSE)]
    needed = {config.imu_name} | ({one.sensor for one in points} if all(one in absent for one in points) else set())
    return [one for one in absent if one.sensor in needed]


def _reason(recording: Recording, topic: str) -> str:
    near = get_close_matches(topic, [info.topic for info in recording.topics], n=1)
    return f"the recording has no topic {topic!r}" + (f"; did you mean {near[0]!r}?" if near else "")
