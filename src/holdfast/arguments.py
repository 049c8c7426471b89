"""Arguments of the functions that a program calls: another type or range is an error that names the argument."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from holdfast.errors import ConfigError
from holdfast.measured_fields import got, has_double, is_number, is_stamp, is_whole


def path_of(name: str, path: object) -> Path:
    """Return an argument as a path, and refuse what is none; an empty one would be the folder of the program.

    Raises:
        ConfigError: names the argument, and what came.
    """
    if not isinstance(path, str | PathLike):
        raise ConfigError(f"{name}: must be a path, not {type(path).__name__}")
    if not str(path):
        raise ConfigError(f"{name}: must be a path, got an empty text")
    if "\0" in str(path):
        raise ConfigError(f"{name}: must be a path, which holds no NUL")
    return Path(path)


def check_flag(name: str, value: object) -> None:
    """Refuse what is neither true nor false: a text would count as true, whatever it says.

    Raises:
        ConfigError: names the argument, and what came.
    """
    if not isinstance(value, bool | np.bool_):
        raise ConfigError(f"{name}: must be True or False, {got(value)}")


def check_choice(name: str, value: object, allowed: Sequence[str]) -> None:
    """Refuse what is none of some words.

    Raises:
        ConfigError: names the argument, and what came.
    """
    if not isinstance(value, str) or value not in allowed:  # an array is equal to them one by one
        raise ConfigError(f"{name}: must be one of {', '.join(allowed)}, {got(value)}")


def check_seconds(name: str, value: object, least_s: float = 0.0) -> None:
    """Refuse what is no time, or one of less than `least_s`; infinity is one.

    Raises:
        ConfigError: names the argument, and what came.
    """
    if not is_number(value) or not has_double(value) or not value >= least_s:
        raise ConfigError(f"{name}: must be a number [s] >= {least_s:g}, {got(value)}")


def check_count(name: str, value: object, least: int) -> None:
    """Refuse what is no whole number, or less than `least`.

    Raises:
        ConfigError: names the argument, and what came.
    """
    if not is_whole(value) or value < least:
        raise ConfigError(f"{name}: must be an integer >= {least}, {got(value)}")


def check_time(name: str, value: object) -> None:
    """Refuse what is no time as messages have it.

    Raises:
        ConfigError: names the argument, and what came.
    """
    if not is_stamp(value):
        raise ConfigError(f"{name}: must be a whole number of nanoseconds within 64 bits, {got(value)}")
