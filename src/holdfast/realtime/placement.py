"""Where the two processes run: cores and priorities, as configured."""

import os

from holdfast.config.realtime import RealtimeConfig
from holdfast.errors import ConfigError


def place_caller(config: RealtimeConfig) -> None:
    """Give the calling thread its core and its priority.

    Raises:
        ConfigError: this machine does not allow it.
    """
    check_core("imu_core", config.imu_core)
    check_core("optimiser_core", config.optimiser_core)
    if config.imu_core is not None:
        os.sched_setaffinity(0, {config.imu_core})
    if config.imu_priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(config.imu_priority))
        except (OSError, AttributeError):
            raise ConfigError(
                f"realtime.imu_priority = {config.imu_priority}: not allowed here (Linux, and CAP_SYS_NICE)"
            ) from None


def place_optimiser(config: RealtimeConfig) -> None:
    """Give this process, the optimiser, its core and its niceness."""
    if config.optimiser_core is not None:
        os.sched_setaffinity(0, {config.optimiser_core})
    if config.optimiser_nice:
        os.nice(config.optimiser_nice)


def check_core(name: str, core: int | None) -> None:
    """Refuse a core that this process may not use.

    Raises:
        ConfigError: names the setting and the cores.
    """
    if core is None:
        return
    if not hasattr(os, "sched_getaffinity"):
        raise ConfigError(f"realtime.{name} = {core}: this system does not tie processes to cores")
    allowed = sorted(os.sched_getaffinity(0))
    if core not in allowed:
        raise ConfigError(f"realtime.{name} = {core}: must be one of {', '.join(map(str, allowed))}")
