"""Names of topics, as ROS 2 allows them."""

import re

from holdfast.errors import ConfigError
from holdfast.printable import quoted

TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


def check_topic(given: str, topic: str) -> None:
    """Refuse a topic that no program of ROS 2 could name; `given` is the option or the key that has it.

    Raises:
        ConfigError: names both.
    """
    if not TOPIC.fullmatch(topic):
        raise ConfigError(
            f"{given}: {quoted(topic)!r} is no name of a topic (allowed: words of letters, digits and _ with / between "
            "them, none beginning with a digit, such as /lidar/odometry)"
        )
