"""What a command writes about itself can be typed again."""

import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

sys.path.append(str(Path(__file__).parents[1] / "replay"))

from small_drive import holdfast

from holdfast.cli.command_line import command_line


@click.group()
def tool() -> None: ...


@tool.command()
@click.argument("files", nargs=-1)
@click.option("-o", "--output")
@click.option("--rate", type=float, default=1.0)
@click.option("--hold-out", multiple=True)
@click.option("--quick", is_flag=True)
def work(**_: object) -> None:
    click.echo(command_line())


@pytest.mark.parametrize(
    "typed",
    [
        "work",
        "work a.bag b.bag -o out",
        "work a.bag --rate 2.5 --hold-out gnss=2 --hold-out gnss_right=3 --quick",
        "work 'my drive.bag' -o 'a folder'",
    ],
)
def test_a_command_comes_back_as_it_was_typed(typed: str):
    printed = CliRunner().invoke(tool, shlex.split(typed), prog_name="tool", catch_exceptions=False).output
    assert printed.strip() == f"tool {typed}"
    assert printed == CliRunner().invoke(tool, shlex.split(printed)[1:], prog_name="tool").output


def test_what_was_left_at_its_default_is_left_out():
    assert CliRunner().invoke(tool, ["work"], prog_name="tool").output == "tool work\n"


def test_the_program_is_called_holdfast_however_it_is_started():
    """`python -c "from holdfast.cli import main; main()"` wrote `-c replay ...` into summary.json and its usage."""
    program = [sys.executable, "-c", "from holdfast.cli import main; main()"]
    done = subprocess.run([*program, "replay", "--help"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("Usage: holdfast replay [OPTIONS] RECORDING\n")


def test_the_package_can_be_run_where_the_script_is_not_on_the_path():
    command = [sys.executable, "-m", "holdfast", "info", "nowhere"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3 and done.stderr == "error: nowhere: no such file or folder\n"


@pytest.mark.parametrize(("typed", "option"), [
    ("replay a.mcap -c a.yaml -o out --duration 5 --duration 10", "--duration"),
    ("replay a.mcap -c a.yaml -o out -c b.yaml", "--config"),
    ("evaluate a.tum b.tum --align yaw --align=none", "--align"),
    ("config init a.mcap -o a.yaml --output b.yaml", "--output"),
])  # fmt: skip
def test_an_option_that_takes_one_value_is_refused_when_it_is_given_two(typed, option):
    """The last one counted, without a word about the first."""
    done = holdfast(*typed.split())
    assert done.code == 2
    assert done.err.splitlines()[-1] == f"Error: Option '{option}' is given twice."


def test_flags_and_options_that_take_several_values_may_be_given_again():
    assert holdfast("info", "nowhere", "--json", "--json").code == 3
    assert "nowhere" in holdfast("evaluate", "nowhere", "b", "--rpe-time", "1", "--rpe-time", "2").err
