"""Where the two processes run: cores and priorities, as configured."""

import os

from holdfast.config.realtime import RealtimeConfig
from holdfast.errors import ConfigError


def place_caller(config: RealtimeConfig) -> frozenset[int] | None:
    """Give the calling thread its core and its priority; return the cores that it might use before, if this is known.

    Raises:
        ConfigError: this machine does not allow it.
    """
    cores = frozenset(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
    check_core("imu_core", config.imu_core)
    check_core("optimiser_core", config.optimiser_core)
    if config.imu_core is not None:
        os.sched_setaffinity(0, {config.imu_core})
    if config.imu_priority:
        try:
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # the optimiser must not inherit it
            os.sched_setscheduler(0, policy, os.sched_param(config.imu_priority))
        except (OSError, AttributeError):
            raise ConfigError(
                f"realtime.imu_priority = {config.imu_priority}: not allowed here (Linux, and CAP_SYS_NICE)"
            ) from None
    return cores


def release_cores(cores: frozenset[int] | None) -> None:
    """Let the calling thread use what the thread that started it might use before it was tied to a core."""
    if cores is not None:
        os.sched_setaffinity(0, cores)


def place_optimiser(config: RealtimeConfig, cores: frozenset[int] | None) -> None:
    """Give this process, the optimiser, its core, or all that there were, and its niceness."""
    release_cores(cores if config.optimiser_core is None else frozenset({config.optimiser_core}))
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
