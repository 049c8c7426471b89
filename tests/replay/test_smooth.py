"""`holdfast smooth`: what it writes, what it says, and what else reads it."""

import json

import numpy as np
import pytest
from small_drive import EPOCH_NS, FILES, holdfast, pose

from holdfast.recording.covariance_csv import HEADER, beside, read_covariances
from holdfast.recording.tum import read_tum, write_tum


@pytest.fixture(scope="module")
def smoothed(tmp_path_factory, bag_drive, with_base):
    folder = tmp_path_factory.mktemp("smoothed")
    done = holdfast("smooth", bag_drive, "-c", with_base, "-o", folder, "--hold-out", "gnss=5")
    assert done.code == 0, done.err
    return folder, done.out


def test_it_writes_the_optimum_and_the_causal_run_beside_it(smoothed):
    folder, _ = smoothed
    names = {file.name for file in folder.iterdir()}
    assert names == {
        "imu_in_world.tum", "base_in_world.tum", "imu_in_world.covariance.csv",
        "biases.csv", "refused.csv", "summary.json", "causal", ".holdfast",
    }  # fmt: skip
    assert {file.name for file in (folder / "causal").iterdir()} == (
        FILES - {".holdfast"} | {"base_in_world.tum", "base_in_odom.tum"}
    )


def test_the_optimum_is_where_the_machine_was(smoothed):
    track = read_tum(smoothed[0] / "imu_in_world.tum")
    true = np.array([pose((stamp - EPOCH_NS) * 1e-9).translation() for stamp in track.stamps_ns.tolist()])
    causal = read_tum(smoothed[0] / "causal" / "imu_in_world.tum")
    at_causal = np.array([pose((stamp - EPOCH_NS) * 1e-9).translation() for stamp in causal.stamps_ns.tolist()])
    moved = (true - track.positions).mean(axis=0)  # W begins where the first fix was
    error, of_causal = (np.sqrt(np.mean(np.sum((a - b - moved) ** 2, axis=1))) for a, b in (
        (true, track.positions), (at_causal, causal.positions)))  # fmt: skip
    assert error < of_causal and error < 0.02


def test_the_chassis_rides_on_the_optimum(smoothed):
    imu, base = (read_tum(smoothed[0] / f"{name}_in_world.tum") for name in ("imu", "base"))
    rows = np.searchsorted(imu.stamps_ns, base.stamps_ns)
    distance = np.linalg.norm(imu.positions[rows] - base.positions, axis=1)
    assert len(base.stamps_ns) > 1000 and np.ptp(distance) < 1e-6


def test_the_summary_says_what_the_optimum_cost_and_how_good_it_is(smoothed):
    summary = json.loads((smoothed[0] / "summary.json").read_text())
    found = summary["smooth"]
    assert found["counts"]["gnss"]["used"] > 50 and found["iterations"] > 1 and found["wall_s"] > 0.0
    assert found["windows"][0]["cost_after"] < found["windows"][0]["cost_before"]
    assert summary["held_out"]["batch"]["all"]["horizontal_m"]["count"] > 10
    assert summary["held_out"]["batch"]["all"]["nees_per_dof"] > 0.0
    assert "smooth" not in json.loads((smoothed[0] / "causal" / "summary.json").read_text())


def test_it_prints_the_errors_of_the_optimum_beside_the_causal_ones(smoothed):
    out = smoothed[1]
    assert "held out, causal" in out and "held out, batch" in out and "optimum: cost" in out


def test_covariances_read_back_as_they_were_written(smoothed):
    covariances = read_covariances(smoothed[0] / "imu_in_world.covariance.csv")
    assert (np.diff(covariances.times_ns) > 0).all()
    assert np.linalg.eigvalsh(covariances.values).min() > 0.0


def test_evaluate_judges_the_covariances_beside_an_estimate(smoothed, tmp_path):
    track = read_tum(smoothed[0] / "imu_in_world.tum")
    reference = tmp_path / "reference.tum"
    write_tum(reference, track)
    done = holdfast("evaluate", smoothed[0] / "imu_in_world.tum", reference, "--json", tmp_path / "out.json")
    assert done.code == 0, done.err
    assert "NEES of position: 0.00 per degree of freedom" in done.out and "NEES of attitude" in done.out
    assert json.loads((tmp_path / "out.json").read_text())["consistency"]["position"]["mean_nees_per_dof"] < 1e-6


def test_a_damaged_table_of_covariances_is_named_with_its_line(smoothed, tmp_path):
    track = tmp_path / "track.tum"
    write_tum(track, read_tum(smoothed[0] / "imu_in_world.tum"))
    beside(track).write_text(",".join(HEADER) + "\n12,oops\n")
    done = holdfast("evaluate", track, track)
    assert done.code == 3 and done.err.splitlines() == [f"error: {beside(track)}:2: is not made of numbers"]


def test_a_report_can_be_made_of_it(smoothed, tmp_path):
    pytest.importorskip("plotly")
    done = holdfast("report", smoothed[0], "-o", tmp_path / "page.html")
    assert done.code == 0, done.err
    assert "optimum over the recording" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize(
    "mistake",
    [
        ("--window", 1, "error: --window 1: must be from 10 to 36000 s"),
        ("--overlap", 0, "error: --overlap 0: must be from 5 to 3600 s"),
        ("--hold-out", "gps=2", "error: --hold-out gps=2: sensor 'gps' is not configured (allowed: imu, gnss, lidar)"),
    ],
)
def test_a_mistaken_option_is_one_line(bag_drive, with_base, tmp_path, mistake):
    option, value, line = mistake
    done = holdfast("smooth", bag_drive, "-c", with_base, "-o", tmp_path / "out", option, value)
    assert (done.code, done.err.splitlines()) == (2, [line])
    assert not (tmp_path / "out").exists()


def test_a_recording_in_which_nothing_starts_says_why(bag_drive, with_base, tmp_path):
    done = holdfast("smooth", bag_drive, "-c", with_base, "-o", tmp_path / "out", "--duration", 0.5)
    assert done.code == 4 and "never started" in done.err
