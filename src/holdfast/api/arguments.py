"""Arguments of the functions that a program calls: another type is an error that names the argument."""

from os import PathLike
from pathlib import Path

from holdfast.errors import ConfigError


def path_of(name: str, path: object) -> Path:
    """Return an argument as a path, and refuse what is none.

    Raises:
        ConfigError: names the argument, and what came.
    """
    if not isinstance(path, str | PathLike):
        raise ConfigError(f"{name}: must be a path, not {type(path).__name__}")
    if "\0" in str(path):
        raise ConfigError(f"{name}: must be a path, which holds no NUL")
    return Path(path)
