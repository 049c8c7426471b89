"""Ctrl-C wherever a command is: one line, the exit code of the signal, and nothing goes on."""

import ctypes
import os
import signal
import sys
import time
from importlib import import_module
from pathlib import Path

import click
import pytest

sys.path.append(str(Path(__file__).parents[1] / "replay"))

from small_drive import holdfast, write_config, write_mcap

from holdfast.cli import STOPS, end_if_interrupted

HANDLED = (*STOPS, signal.SIGALRM)


@pytest.fixture
def command(monkeypatch):
    """Have `holdfast info` do something else."""

    def have(work):
        monkeypatch.setattr(module_of("info"), "info", click.command("info")(work))

    return have


def module_of(name):
    return import_module(f"holdfast.cli.{name}")


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


def test_ctrl_c_in_a_command_that_is_named_like_a_builtin_is_one_line(command):
    """The module of `holdfast map` hid the function `map` from the line that is printed."""
    module_of("map")
    command(interrupt)
    done = holdfast("info")
    assert done.code == 128 + signal.SIGINT
    assert done.err.strip() == "interrupted"


def test_ctrl_c_that_a_callback_swallows_ends_the_command_all_the_same(command, capfd):
    """Numba's compiler calls back from C, where exceptions are printed and forgotten: `calibrate` went on."""
    rounds = []

    def work():
        callback = ctypes.CFUNCTYPE(None)(interrupt)
        callback()
        for _ in range(1000):
            time.sleep(0.01)
            rounds.append(1)

    command(work)
    done = holdfast("info")
    assert done.code == 128 + signal.SIGINT
    assert done.err.strip() == "interrupted"
    assert "Traceback" not in capfd.readouterr().err
    assert len(rounds) < 1000


def test_handlers_are_those_of_before_when_a_command_has_ended(command):
    before = [signal.getsignal(number) for number in HANDLED], sys.unraisablehook
    command(interrupt)
    holdfast("info")
    assert ([signal.getsignal(number) for number in HANDLED], sys.unraisablehook) == before
    end_if_interrupted()  # what comes next in this process was not
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    return write_mcap(folder / "bag"), write_config(folder / "config.yaml")


def interrupted_in(monkeypatch, name, drive, out):
    """Press Ctrl-C where a session does something."""
    session = import_module("holdfast.api.session")
    done = getattr(session, name)

    def press(*args, **options):
        interrupt()
        return done(*args, **options)

    monkeypatch.setattr(session, name, press)
    bag, config = drive
    return holdfast("replay", bag, "-c", config, "-o", out, "--duration", "4")


@pytest.mark.parametrize("name", ["Outputs", "ReplayedScans", "Replay"])
def test_ctrl_c_before_the_first_message_leaves_nothing(monkeypatch, drive, tmp_path, name):
    """It left a folder of headers without a summary, and said that what was done was there."""
    done = interrupted_in(monkeypatch, name, drive, tmp_path / "out")
    assert done.code == 128 + signal.SIGINT
    assert done.err.strip().endswith("interrupted: nothing was done yet")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["learnt_rows", "summarise_replay", "_write_summary"])
def test_ctrl_c_after_the_last_message_waits_for_the_summary(monkeypatch, drive, tmp_path, name):
    """It left all tracks without a summary."""
    done = interrupted_in(monkeypatch, name, drive, tmp_path / "out")
    assert done.code == 128 + signal.SIGINT
    assert done.err.strip().endswith(f"interrupted: what was done until then is in {tmp_path / 'out'}")
    assert (tmp_path / "out" / "summary.json").stat().st_size > 1000
