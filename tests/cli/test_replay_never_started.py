"""`holdfast replay` where the estimator never starts: exit code 4, and why."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from bags import write_bag
from replay_command import assert_one_error, run_command
from small_drive import (
    FILES,
    bag_messages,
    config_text,
    events,
    holdfast,
    summary,
    write_config,
    write_csv,
)


def assert_outputs_say_why(folder, *words):
    assert {file.name for file in folder.iterdir()} == FILES
    result = summary(folder)
    assert result["finished"] is True
    assert result["initialised"] is False
    for word in words:
        assert word in result["waiting_for"]
    assert isinstance(events(folder), list)
    assert (folder / "imu_in_world.tum").read_bytes() == b""


def test_gnss_without_a_fix_throughout_ends_with_the_reason(rows, tmp_path):
    lost = replace(rows, gnss=[(at, arrival, (*v[:3], -1, *v[4:])) for at, arrival, v in rows.gnss])
    drive = write_csv(tmp_path / "csv", lost)
    config = write_config(tmp_path / "config.yaml", datum=False)
    done = run_command(drive, "-c", config, "-o", tmp_path / "out")
    assert_one_error(done, 4, drive, "never started", "no usable position")
    assert_outputs_say_why(tmp_path / "out", "no usable position")
    assert summary(tmp_path / "out")["counts"]["gnss"] == {"low_status": len(rows.gnss)}
    assert {event["reason"] for event in events(tmp_path / "out")} == {"low_status"}


def test_fixes_that_claim_too_much_end_with_their_number_the_claim_and_the_key(rows, tmp_path):
    unsure = replace(rows, gnss=[(at, arrival, (*v[:4], 12.3, 9.0, 20.0)) for at, arrival, v in rows.gnss])
    drive = write_csv(tmp_path / "csv", unsure)
    config = write_config(tmp_path / "config.yaml", datum=False)
    done = holdfast("replay", drive, "-c", config, "-o", tmp_path / "out")
    refused = f"gnss: {len(rows.gnss)} large_covariance (sensors.gnss.max_sigma_m = 1.0)"
    assert_one_error(done, 4, drive, "never started", "it claims 12.3 m", f"imu: {len(rows.imu)} used", refused)
    assert_outputs_say_why(tmp_path / "out", "the last of gnss was refused: large_covariance")


def test_a_receiver_without_a_covariance_is_weighed_by_its_status_with_one_warning(rows, tmp_path):
    messages = [
        (topic, arrival, replace(message, position_covariance_type=0) if topic == "gnss" else message)
        for topic, arrival, message in bag_messages(rows)
    ]
    drive = write_bag(tmp_path / "bag", "mcap", messages)
    done = holdfast("replay", drive, "-c", write_config(tmp_path / "config.yaml"), "-o", tmp_path / "out")
    assert done.code == 0, done.err
    warnings = [line for line in done.err.splitlines() if "covariance" in line]
    assert len(warnings) == 1
    assert "sigmas of 0.02, 0.02, 0.04 m are assumed; sensors.gnss.default_sigma_m sets them" in warnings[0]
    assert warnings[0] == f"warning: {summary(tmp_path / 'out')['warnings'][-1]}"
    assert [event["sensor"] for event in events(tmp_path / "out") if event["kind"] == "covariance_assumed"] == ["gnss"]
    assert summary(tmp_path / "out")["counts"]["gnss"]["used"] > 0.8 * len(rows.gnss)


@pytest.mark.parametrize("how", ["no fix", "no message"])
def test_gnss_that_is_absent_is_the_reason_with_a_datum_too(rows, tmp_path, how):
    bad = [(at, arrival, (*v[:3], -1, *v[4:])) for at, arrival, v in rows.gnss] if how == "no fix" else []
    drive = write_csv(tmp_path / "csv", replace(rows, gnss=bad))
    done = holdfast("replay", drive, "-c", write_config(tmp_path / "config.yaml"), "-o", tmp_path / "out")
    assert_one_error(done, 4, drive, "never started", "no usable position")
    assert_outputs_say_why(tmp_path / "out", "no usable position")


def test_an_accelerometer_in_g_is_guessed(rows, tmp_path):
    in_g = [(at, arrival, (*v[:3], *(x / 9.81 for x in v[3:]))) for at, arrival, v in rows.imu]
    drive = write_csv(tmp_path / "csv", replace(rows, imu=in_g))
    done = holdfast("replay", drive, "-c", write_config(tmp_path / "config.yaml"), "-o", tmp_path / "out")
    why = "sensors.imu.accelerometer_factors looks wrong (gravity shows that its accelerometer gives g): [9.80665, "
    assert_one_error(done, 4, "never started", "is the accelerometer in g?", why)
    assert_outputs_say_why(tmp_path / "out", "is the accelerometer in g?")
    assert summary(tmp_path / "out")["looks_wrong"][0].startswith(why)
    config = write_config(tmp_path / "right.yaml", imu={"accelerometer_factors": [9.81, 9.81, 9.81]})
    done = holdfast("replay", drive, "-c", config, "-o", tmp_path / "right")
    assert done.code == 0, done.err
    assert summary(tmp_path / "right")["looks_wrong"] == []


def test_standstill_without_a_heading_says_what_to_give(rows, tmp_path):
    drive = write_csv(tmp_path / "csv", rows)
    settings = json.loads(config_text())
    del settings["initialisation"]
    (tmp_path / "config.yaml").write_text(json.dumps(settings))
    done = holdfast("replay", drive, "-c", tmp_path / "config.yaml", "-o", tmp_path / "out", "--duration", 2.5)
    assert_one_error(done, 4, "never started", "initialisation.heading_deg")


def test_where_the_imu_is_missing_too_gnss_is_not_said_to_be_all_that_is_missing(rows, tmp_path):
    drive = write_csv(tmp_path / "csv", replace(rows, imu=[], gnss=[]))
    config = write_config(tmp_path / "config.yaml", datum=False)
    done = holdfast("replay", drive, "-c", config, "-o", tmp_path / "out")
    words = "no usable IMU sample has come, and no usable position has come. Received: imu: nothing; gnss: nothing"
    assert_one_error(done, 4, drive, "never started", words)
