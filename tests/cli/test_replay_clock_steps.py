"""`holdfast replay` of recordings in which all clocks step: it ends, and says what was seen."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from small_drive import Rows, events, holdfast, make_rows, pose, stamp, summary, write_config, write_csv, write_mcap

from holdfast.recording.tum import read_tum

STEP_S = 8.0
DECADES_NS = 1_577_880_000_000_000_000


def stepped(with_arrivals):
    """The drive, whose clocks show 1973 until they show 2023."""
    rows = make_rows()

    def shown(row):
        at, arrival, values = row
        by_ns = -DECADES_NS if at < stamp(STEP_S) else 0
        return at + by_ns, arrival + (by_ns if with_arrivals else 0), values

    return Rows(*([shown(row) for row in series] for series in (rows.imu, rows.gnss, rows.lidar)))


def test_an_estimator_that_begins_anew_at_the_end_is_not_said_to_have_never_started(tmp_path):
    rows = stepped(with_arrivals=True)
    until = Rows(
        *([row for row in series if row[0] < stamp(STEP_S + 0.5)] for series in (rows.imu, rows.gnss, rows.lidar))
    )
    drive, out = write_csv(tmp_path / "drive", until), tmp_path / "out"
    done = holdfast("replay", drive, "-c", write_config(tmp_path / "config.yaml"), "-o", out)
    assert done.code == 0, done.err
    assert len(read_tum(out / "imu_in_world.tum").stamps_ns) > 400
    (warning,) = summary(out)["warnings"]
    assert "the estimator had begun anew, and was not running at the end: " in warning
    assert "never started" not in done.err


@pytest.mark.parametrize("write", [write_csv, write_mcap])
@pytest.mark.parametrize("with_arrivals", [True, False])
def test_a_boot_without_a_clock_ends_and_is_told(write, with_arrivals, tmp_path):
    config, out = write_config(tmp_path / "config.yaml"), tmp_path / "out"
    done = holdfast("replay", write(tmp_path / "drive", stepped(with_arrivals)), "-c", config, "-o", out)
    assert done.code == 0, done.err
    (told,) = [event for event in events(out) if event["kind"] == "clock_step" and event["sensor"] == "imu"]
    assert summary(out)["timing"]["recorded_s"] < 60.0, "the years between are no time that was recorded"
    assert "1577880000" in told["reason"] or "1577879999.99" in told["reason"]
    assert ("starting over" if with_arrivals else "carried over") in told["reason"]
    track = read_tum(out / "imu_in_world.tum")
    later = track.stamps_ns >= stamp(STEP_S + 10.0)
    assert later.sum() > 190 and not later.all()
    truth = np.array([pose((at - stamp(0.0)) * 1e-9).translation() for at in track.stamps_ns[later].tolist()])
    assert np.linalg.norm(track.positions[later] - truth, axis=1).max() < 0.15  # fixes of 2, 3 and 5 cm
    assert track.stamps_ns[0] < stamp(STEP_S) - DECADES_NS
    done = holdfast("report", out)
    assert done.code == 0, done.err
