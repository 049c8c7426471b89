"""A simulated drive and its replay, made once."""

import contextlib
import io
import sys

import pytest

from holdfast.cli import main


def holdfast(*arguments):
    """Run the command line in this process; return its exit code and its output."""
    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patched, contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        patched.setattr(sys, "argv", ["holdfast", *map(str, arguments)])
        try:
            main()
        except SystemExit as stop:
            return stop.code or 0, out.getvalue()
    return 0, out.getvalue()


@pytest.fixture(scope="session")
def run():
    return holdfast


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("viz") / "quick"
    assert holdfast("simulate", "quick", "-o", folder, "--duration", 8)[0] == 0
    return folder


@pytest.fixture(scope="session")
def replayed(drive):
    folder = drive.parent / "out"
    assert holdfast("replay", drive / "recording.mcap", "-c", drive / "config.yaml", "-o", folder)[0] == 0
    return folder
