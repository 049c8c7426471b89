"""Whether the driver of an IMU gives other units or signs than a configuration says: asked where a run went badly."""

from collections.abc import Mapping, Sequence

from holdfast.config.model import Config
from holdfast.messages import Message
from holdfast.recording import velocity_convention
from holdfast.recording.imu_beside_receivers import ORDERS, WINDOWS_S, imu_rows, read_window, received_beside
from holdfast.recording.imu_mended import Mended, Received, mended
from holdfast.recording.source import Recording
from holdfast.recording.subscriptions import subscriptions


def driver_faults(recording: Recording, config: Config) -> list[str]:
    """Return a line about each key of the IMU that its driver contradicts; reads at most five minutes.

    Fixes of receivers judge, and their velocities where these go with the fixes.
    """
    there = {info.topic for info in recording.topics}
    compared = [one for one in subscriptions(config) if one.sensor == config.imu_name or one.kind in ORDERS]
    wanted = [one for one in compared if one.topic in there]
    receivers = {one.sensor: ORDERS[one.kind] for one in wanted if one.kind in ORDERS}
    messages: dict[str, list[Message]] = {one.sensor: [] for one in wanted}
    for start_s, duration_s in WINDOWS_S:
        for message in read_window(recording, wanted, start_s, duration_s):
            messages[message.sensor].append(message)
    if not messages.get(config.imu_name):
        return []
    received = {name: _moved(one, name, config) for name, one in _believed(messages, config, receivers).items()}
    return _told(mended(*imu_rows(messages[config.imu_name]), received), config)


def _believed(
    messages: Mapping[str, Sequence[Message]], config: Config, receivers: Mapping[str, int]
) -> dict[str, Received]:
    """Return the fixes, and the velocities that go with the first of them."""
    received = received_beside(messages, config.imu_name, receivers)
    fixes = next((one for one in received.values() if one.order == ORDERS["gnss"]), None)
    return {
        name: one
        for name, one in received.items()
        if fixes is None or one.order != ORDERS["gnss_velocity"] or _goes_with(one, fixes)
    }


def _goes_with(velocities: Received, fixes: Received) -> bool:
    rows = fixes.times_s, fixes.values, velocities.times_s, velocities.values
    return velocity_convention.mistake(*rows) is None


def _moved(one: Received, name: str, config: Config) -> Received:
    """Return what a receiver says with its stamps as the configuration has them, beside those of the IMU."""
    later_s = config.sensors[name].time_offset_s - config.imu.time_offset_s
    return one._replace(times_s=one.times_s + later_s, behind_s=one.behind_s - later_s)


def _told(imu: Mended, config: Config) -> list[str]:
    """Return the lines: of the IMU, whose readings are already times what the configuration says."""
    lines, why = [], "; ".join(imu.mistakes)
    for key, factors in imu.needed.items():
        better = ", ".join(f"{factor:.6g}" for factor in factors * getattr(config.imu, key))
        lines.append(f"sensors.{config.imu_name}.{key} looks wrong ({why}): [{better}]")
    return lines
