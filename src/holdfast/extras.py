"""What a user reads when something needs packages that are not installed."""

from collections.abc import Iterator
from contextlib import contextmanager

from holdfast.errors import ConfigError


def how_to_install(extras: str) -> str:
    """Return the command that installs extras; Holdfast is in no package index, so a checkout must be at hand."""
    return f"pip install -e '.[{extras}]' in the checkout of Holdfast"


@contextmanager
def needing(what: str, extra: str) -> Iterator[None]:
    """Report a failed import in one line.

    Raises:
        ConfigError: names what needs which package, and the command that installs it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or extra).partition(".")[0]
        raise ConfigError(f"{what} needs {package}: {how_to_install(extra)}") from None
