"""Configurations of version 0.1, which have one lidar and two antennas at most: a sensor's name is its kind there."""

from collections.abc import Iterator
from typing import Any

KIND_OF_NAME = {
    "imu": "imu",
    "gnss": "gnss",
    "gnss_right": "gnss",
    "lidar": "odometry",
    "heading": "heading",
    "joint": "joint",
    "base_imu": "base_imu",
}
RENAMED = {  # (section, old key) -> new key
    ("graph", "main_lidar"): "main_odometry",
    ("graph", "fallback_lidar"): "fallback_odometry",
    ("gate", "witness"): "drift_monitor",
}
SWITCHED_OFF = "left out"


def old_forms(data: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield what is of the old form in a configuration's data: section, key, and what it is now.

    That is a new key, the `kind` that is missing, or `SWITCHED_OFF` for the name of a sensor with nothing below it.
    """
    sensors = data.get("sensors")
    for name, sensor in sensors.items() if isinstance(sensors, dict) else ():
        if name in KIND_OF_NAME and sensor is None and name != "imu":
            yield "sensors", name, SWITCHED_OFF
        elif name in KIND_OF_NAME and (sensor is None or (isinstance(sensor, dict) and "kind" not in sensor)):
            yield "sensors", name, f"kind: {KIND_OF_NAME[name]}"
    for (section, key), new in RENAMED.items():
        if isinstance(data.get(section), dict) and key in data[section]:
            yield section, key, new


def modernised(data: dict[str, Any]) -> dict[str, Any]:
    """Return the data in the form of now; those that are of it already are returned as they are."""
    found = {name: dict(section) if isinstance(section, dict) else section for name, section in data.items()}
    for section, key, new in old_forms(data):
        value = found[section].pop(key)
        if section != "sensors":
            found[section][new] = value
        elif new != SWITCHED_OFF:
            found[section][key] = {"kind": KIND_OF_NAME[key]} | (value or {})
    if isinstance(found.get("sensors"), dict):  # in the order of the file
        found["sensors"] = {name: found["sensors"][name] for name in data["sensors"] if name in found["sensors"]}
    return found
