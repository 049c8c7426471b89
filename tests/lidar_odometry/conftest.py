"""The bags of the recording tests serve here too, and one with clouds serves all."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "recording"))

from bags import HUMBLE, bare, odometry, write_bag
from cloud_bags import messages
from yard import START_NS


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A bare MCAP file whose lidar odometry is there already."""
    more = [("/lidar/odometry", START_NS + 10, odometry(HUMBLE, START_NS))]
    return bare(write_bag(tmp_path_factory.mktemp("bag") / "in", "mcap", messages(HUMBLE, more)))
