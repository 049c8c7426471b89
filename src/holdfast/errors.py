"""Every exception that Holdfast raises on purpose.

A rejected or late measurement is no error: it is a counted, typed outcome (see `holdfast.events.Event`).
"""

from holdfast.printable import one_line


class HoldfastError(Exception):
    """Base of all errors; its text says what, where and what is allowed, in one line per fault."""

    exit_code = 1

    def __str__(self) -> str:
        """Return the text, fit to be printed, whatever an input of which it tells was called."""
        return "\n".join(map(one_line, super().__str__().split("\n")))


class ConfigError(HoldfastError):
    """The configuration or the command line asks for something that is not allowed."""

    exit_code = 2


class MessageError(HoldfastError):
    """A program gave a measurement of a wrong type, shape or range: the text names the argument and what it must be."""

    exit_code = 2


class RecordingError(HoldfastError):
    """A recording cannot be read: the text names the file and, where known, the topic and the stamp."""

    exit_code = 3


class EstimatorError(HoldfastError):
    """The estimator cannot do its work on this data, for example because it never initialised."""

    exit_code = 4
