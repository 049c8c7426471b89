"""measurements.csv: what became of each measurement, with its innovation."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from small_drive import holdfast

from holdfast.errors import RecordingError
from holdfast.event_log import EventLog, MeasurementRecord
from holdfast.events import Outcome
from holdfast.replay.measurements import (
    MAX_ROWS_PER_S,
    MEASUREMENTS,
    MeasurementWriter,
    innovation_scores,
    read_measurements,
)

START_NS = 1_600_000_000_000_000_000


def written(path: Path, records: list[MeasurementRecord], outcome: str = "") -> Path:
    with MeasurementWriter(path) as writer:
        writer.write(records, outcome)
    return path


def test_measurements_agree_with_the_counts_of_the_summary(tmp_path: Path, bag_drive, without_base):
    done = holdfast("replay", bag_drive, "-c", without_base, "-o", tmp_path / "out", "--hold-out", "gnss=3")
    assert done.code == 0, done.err
    counts = json.loads((tmp_path / "out" / "summary.json").read_text())["counts"]
    fixes = read_measurements(tmp_path / "out" / MEASUREMENTS)["gnss"]
    found = Counter(fixes.outcomes.tolist())
    assert found.pop("held_out") > 10
    assert found == counts["gnss"]
    used = fixes.outcomes == "used"
    assert np.isfinite(fixes.nis[used]).all()
    assert np.isfinite(fixes.positions).all()
    assert (fixes.dof[used] == 3).all()


def test_a_measurement_that_is_decided_again_keeps_its_innovation_and_takes_the_last_outcome(tmp_path: Path):
    p_W_P = np.array([1.0, 2.0, 3.0])
    records = [
        MeasurementRecord(START_NS, "gnss", Outcome.USED, 2.5, 3, 64.0, p_W_P),
        MeasurementRecord(START_NS + 1, "gnss", Outcome.USED, 1.0, 3, 64.0, p_W_P),
        MeasurementRecord(START_NS, "gnss", Outcome.CONTRADICTED),
    ]
    table = read_measurements(written(tmp_path / "m.csv", records))["gnss"]
    assert table.outcomes.tolist() == ["contradicted", "used"]
    assert table.nis.tolist() == [2.5, 1.0]
    assert table.positions[0].tolist() == [1.0, 2.0, 3.0]


def test_a_flood_of_measurements_does_not_fill_the_disk(tmp_path: Path):
    records = [MeasurementRecord(START_NS + k * 250_000, "gnss", Outcome.USED, 1.0, 3, 64.0) for k in range(8000)]
    records.append(MeasurementRecord(START_NS + 1_999_999_999, "gnss", Outcome.INNOVATION, 99.0, 3, 64.0))
    table = read_measurements(written(tmp_path / "m.csv", records))["gnss"]
    assert Counter(table.outcomes.tolist()) == {"used": 2 * MAX_ROWS_PER_S, "innovation": 1}


def test_stamps_that_go_back_do_not_open_the_file_for_a_flood(tmp_path: Path):
    records = [
        MeasurementRecord(START_NS + (k % 2) * 5_000_000_000 + k, "gnss", Outcome.LATE, 1.0, 3) for k in range(9000)
    ]
    table = read_measurements(written(tmp_path / "m.csv", records))["gnss"]
    assert len(table.stamps_ns) <= 2 * MAX_ROWS_PER_S


def test_what_is_not_finite_is_left_empty(tmp_path: Path):
    record = MeasurementRecord(START_NS, "gnss", Outcome.LOW_STATUS, np.inf, 3, np.inf, np.array([np.nan, 1.0, np.inf]))
    file = written(tmp_path / "m.csv", [record])
    assert file.read_text().splitlines()[1] == f"{START_NS},gnss,low_status,,3,,,1.0000,"
    assert np.isnan(read_measurements(file)["gnss"].nis).all()


def test_the_row_that_a_killed_run_left_unfinished_is_left_out(tmp_path: Path):
    file = written(tmp_path / "m.csv", [MeasurementRecord(START_NS + k, "gnss", Outcome.USED) for k in range(3)])
    file.write_text(file.read_text()[:-8])
    assert len(read_measurements(file)["gnss"].stamps_ns) == 2


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "no such file"), ("", r"m\.csv:1: has other columns"), ("a,b\n", "has other columns"),
     ("stamp_ns,sensor,outcome,nis,dof,limit,east_m,north_m,up_m\nx,gnss,used,1,3,9,0,0,0\n1,2\n", r"m\.csv:2: is no")],
)  # fmt: skip
def test_what_is_no_file_of_measurements_is_named(tmp_path: Path, content: str | None, words: str):
    if content is not None:
        (tmp_path / "m.csv").write_text(content)
    with pytest.raises(RecordingError, match=words):
        read_measurements(tmp_path / "m.csv")


def test_innovations_of_a_right_covariance_score_one(tmp_path: Path):
    rng = np.random.default_rng(3)
    nis = rng.chisquare(3, 4000)
    records = [MeasurementRecord(START_NS + k * 10**9, "gnss", Outcome.USED, n, 3, 64.0) for k, n in enumerate(nis)]
    (score,) = innovation_scores("gnss", read_measurements(written(tmp_path / "m.csv", records))["gnss"])
    assert score.mean_per_dof is not None
    assert score.lower_per_dof is not None
    assert score.upper_per_dof is not None
    assert score.lower_per_dof < score.mean_per_dof < score.upper_per_dof
    assert score.fraction_inside == pytest.approx(0.95, abs=0.012)


def test_nothing_is_recorded_for_nobody():
    log = EventLog("imu")
    log.record(START_NS, "gnss", Outcome.USED)
    assert log.take_records() == []
    log.keep_records()
    log.record(START_NS, "gnss", Outcome.USED)
    assert [record.outcome for record in log.take_records()] == [Outcome.USED]
    assert log.take_records() == []
