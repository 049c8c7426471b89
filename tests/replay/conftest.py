"""The small drive, written once and replayed once."""

import pytest
from small_drive import holdfast, write_config, write_csv, write_mcap


@pytest.fixture(scope="session")
def csv_drive(tmp_path_factory):
    return write_csv(tmp_path_factory.mktemp("drive") / "csv")


@pytest.fixture(scope="session")
def bag_drive(tmp_path_factory):
    return write_mcap(tmp_path_factory.mktemp("drive") / "bag")


@pytest.fixture(scope="session")
def with_base(tmp_path_factory):
    return write_config(tmp_path_factory.mktemp("config") / "with_base.yaml", base=True)


@pytest.fixture(scope="session")
def without_base(tmp_path_factory):
    return write_config(tmp_path_factory.mktemp("config") / "without_base.yaml")


@pytest.fixture(scope="session")
def replayed(tmp_path_factory, bag_drive, with_base):
    """The outputs of the bag with a base."""
    folder = tmp_path_factory.mktemp("replayed")
    done = holdfast("replay", bag_drive, "-c", with_base, "-o", folder)
    assert done.code == 0, done.err
    return folder
