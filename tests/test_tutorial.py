"""The tutorial, executed: every command of it in order, and what it says of the numbers."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "tutorial" / "from-a-bag-to-a-tuned-machine.md"


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder in which all commands were run, and what they printed."""
    folder = tmp_path_factory.mktemp("tutorial")
    blocks = re.findall(r"^```sh\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 8
    program = f"{sys.executable} -c 'import holdfast.cli; holdfast.cli.main()'"
    script = f'set -euo pipefail\nholdfast() {{ {program} "$@"; }}\n' + "\n".join(blocks)
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    ran = subprocess.run(
        ["bash", "-c", script], cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert ran.returncode == 0, ran.stdout[-2000:] + ran.stderr
    assert "Traceback" not in ran.stderr
    return folder, ran.stdout


def outage_rms_m(folder: Path) -> float:
    summary = json.loads((folder / "summary.json").read_text())
    return float(summary["held_out"]["causal"]["outage"]["horizontal_m"]["rms"])


def test_every_command_of_the_tutorial_runs_and_leaves_what_it_names(done):
    folder, _ = done
    named = ("proposal.yaml", "first/report.html", "out/report.html", "track.csv", "track.geojson", "track.kml")
    assert not [name for name in named if not (folder / name).is_file()]


def test_the_numbers_are_those_that_the_tutorial_tells(done):
    folder, printed = done
    assert "2.70" in printed  # the lever arm
    assert outage_rms_m(folder / "first") == pytest.approx(0.07, abs=0.01)
    assert outage_rms_m(folder / "tuned") == pytest.approx(0.04, abs=0.01)
