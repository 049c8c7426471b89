"""The option `--learnt` of the commands that estimate."""

import click

learnt_option = click.option(
    "--learnt",
    "learnt_path",
    type=click.Path(),
    metavar="FILE",
    help="What was learnt of the sensors: read if it is there, written at the end. A day begins where one ended.",
)
