"""The command that is running, as one would type it again: it stands beside the results that it makes."""

import shlex
from collections.abc import Iterator
from typing import Any

import click
from click.core import ParameterSource


def command_line() -> str:
    """Return the running command with what was given to it; options left at their default are left out."""
    context = click.get_current_context()
    return shlex.join([*context.command_path.split(), *_given(context)])


def _given(context: click.Context) -> Iterator[str]:
    """Yield the arguments, then the options, by the first of their names."""
    parameters = sorted(context.command.params, key=lambda one: not isinstance(one, click.Argument))
    for parameter in parameters:
        name = parameter.name or ""
        if context.get_parameter_source(name) is not ParameterSource.COMMANDLINE:
            continue
        value: Any = context.params[name]
        values = value if isinstance(value, tuple) else (value,)
        if isinstance(parameter, click.Argument):
            yield from map(str, values)
            continue
        for one in values:
            yield parameter.opts[0]
            if one is not True:
                yield f"{one:g}" if isinstance(one, float) else str(one)
