"""Arguments of the functions that a program calls: another type is an error that names the argument."""

from os import PathLike

from holdfast.errors import ConfigError


def check_path(name: str, path: object) -> None:
    """Refuse what is no path.

    Raises:
        ConfigError: names the argument, and the type that came.
    """
    if not isinstance(path, str | PathLike):
        raise ConfigError(f"{name}: must be a path, not {type(path).__name__}")
