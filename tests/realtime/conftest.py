"""A short simulated drive, and what the estimator in one process makes of it."""

import pytest
from engine import simulated


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("drive"))
