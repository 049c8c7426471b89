"""Options that are given twice: of two values the last one counted, without a word about the first."""

import click


def refuse_given_twice(command: click.Command, context: click.Context, arguments: list[str]) -> None:
    """Refuse an option that takes one value and is given two; what else is wrong is left to the parser.

    Raises:
        click.UsageError: names the option.
    """
    within = command.context_class(command, info_name=command.name, parent=context)
    try:
        _, rest, given = command.make_parser(within).parse_args(list(arguments))
    except click.UsageError:
        return
    for option in given:
        if isinstance(option, click.Option) and not (option.multiple or option.is_flag) and given.count(option) > 1:
            raise click.UsageError(f"Option '{max(option.opts, key=len)}' is given twice.", within)
    if isinstance(command, click.Group) and rest:
        name, *rest = rest
        if (nested := command.get_command(within, name)) is not None:
            refuse_given_twice(nested, within, rest)
