"""A drive as a folder and as a bag, and a configuration, for whoever replays it."""

import sys
from pathlib import Path

import pytest

sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from small_drive import make_rows, write_config, write_csv, write_mcap


@pytest.fixture(scope="session")
def rows():
    return make_rows()


@pytest.fixture(scope="session")
def drive(tmp_path_factory, rows):
    return write_csv(tmp_path_factory.mktemp("drive") / "csv", rows)


@pytest.fixture(scope="session")
def short(tmp_path_factory):
    """Four seconds in a bag: enough to start."""
    return write_mcap(tmp_path_factory.mktemp("drive") / "bag", make_rows(seconds=4.0))


@pytest.fixture
def config(tmp_path):
    return write_config(tmp_path / "config.yaml")
