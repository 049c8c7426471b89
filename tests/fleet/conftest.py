from pathlib import Path

import pytest
from click.testing import CliRunner

from holdfast.cli import holdfast


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a simulated recording of eight seconds, with its truth and configuration."""
    folder = tmp_path_factory.mktemp("fleet") / "yard"
    arguments = ["simulate", "quick", "-o", str(folder), "--duration", "8"]
    assert CliRunner().invoke(holdfast, arguments, catch_exceptions=False).exit_code == 0
    return folder
