"""One job of a batch: what is judged, and in which world."""

import json
from pathlib import Path

import numpy as np
import pytest

from holdfast.fleet import run
from holdfast.fleet.plan import Job
from holdfast.geometry.earth import Geodetic
from holdfast.recording.tum import write_tum
from holdfast.replay.reference import in_other_world
from holdfast.state import Trajectory

OF_TRUTH, OF_RUN = Geodetic(47.0, 8.0, 400.0), Geodetic(47.001, 8.001, 402.0)


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Job:
    """A job of which the replay puts its datum elsewhere than the simulation, and its track 1 cm too far north."""
    recording, folder = tmp_path / "yard" / "recording.mcap", tmp_path / "out"
    (tmp_path / "yard" / "truth").mkdir(parents=True)
    recording.touch()
    datum = "".join(f"  {name}: {value}\n" for name, value in OF_TRUTH._asdict().items())
    (tmp_path / "yard" / "scenario.yaml").write_text(f"datum:\n{datum}", encoding="utf-8")
    positions = np.column_stack([np.linspace(0.0, 9.0, 10), np.zeros(10), np.zeros(10)])
    truth = Trajectory(np.arange(10) * 100_000_000, positions, np.tile([0.0, 0.0, 0.0, 1.0], (10, 1)))
    write_tum(tmp_path / "yard" / "truth" / "imu_in_world.tum", truth)
    found = Trajectory(truth.stamps_ns, positions + np.array([0.0, 0.01, 0.0]), truth.quaternions)

    def replay(_job: Job, _stop_file: Path) -> tuple[str, str]:
        write_tum(folder / run.ESTIMATE, in_other_world(found, OF_TRUTH, OF_RUN))
        keys = ("recording", "counts", "timing", "held_out", "versions", "config")
        summary = {key: {} for key in keys} | {"datum": OF_RUN._asdict()}
        (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
        return "done", ""

    monkeypatch.setattr(run, "_replay", replay)
    return Job("yard", recording, folder, "", (), (), "1")


def test_a_run_with_another_datum_than_the_simulation_is_judged_in_its_own_world(job: Job, tmp_path: Path):
    """Without `frames.datum`, `results.csv` told how far the first fix was from the datum of the simulation."""
    errors = run.run_job(job, tmp_path / "stop").errors
    assert errors["horizontal_m"] == pytest.approx(0.01, abs=1e-5)
    assert errors["vertical_m"] == pytest.approx(0.0, abs=1e-5)
    assert errors["yaw_deg"] == pytest.approx(0.0, abs=1e-5)
