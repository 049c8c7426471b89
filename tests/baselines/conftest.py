"""One small drive for all tests of the baselines."""

import pytest
from recorded import PERFECT_LIDAR, Recorded


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    """20 s: stand, drive, slew, dig; GNSS is silent from 12 to 16 s."""
    return Recorded(tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="session")
def open_drive(tmp_path_factory):
    """The same with GNSS throughout and a lidar odometry without error."""
    return Recorded(tmp_path_factory.mktemp("open"), faults=[], sensors={"lidar": PERFECT_LIDAR})
