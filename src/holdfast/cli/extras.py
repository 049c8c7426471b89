"""What a user reads when a command needs packages that are not installed."""

from collections.abc import Iterator
from contextlib import contextmanager

from holdfast.errors import ConfigError


@contextmanager
def needing(what: str, extra: str) -> Iterator[None]:
    """Report a failed import in one line.

    Raises:
        ConfigError: names what needs which package, and the extra that brings it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise ConfigError(f"{what} needs {error.name}: pip install 'holdfast[{extra}]'") from None
