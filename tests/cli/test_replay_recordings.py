"""`holdfast replay` of recordings that cannot be read, or lack what is needed: exit code 3, and nothing lost."""

import html
import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from bags import write_bag
from replay_command import assert_one_error, run_command
from small_drive import (
    bag_messages,
    holdfast,
    make_rows,
    stamp,
    summary,
    write_config,
    write_csv,
)

from holdfast.recording.tum import read_tum


def test_a_missing_recording_is_named(config, tmp_path):
    done = run_command(tmp_path / "none.mcap", "-c", config, "-o", tmp_path / "out")
    assert_one_error(done, 3, tmp_path / "none.mcap", "no such file")
    assert not (tmp_path / "out").exists()


def test_an_empty_bag_is_named(config, tmp_path):
    bag = write_bag(tmp_path / "empty", "mcap", [])
    assert_one_error(holdfast("replay", bag, "-c", config, "-o", tmp_path / "out"), 3, "no messages")


def test_an_empty_file_is_named(config, tmp_path):
    (tmp_path / "empty.mcap").touch()
    assert_one_error(holdfast("replay", tmp_path / "empty.mcap", "-c", config, "-o", tmp_path / "o"), 3, "empty.mcap")


@pytest.mark.parametrize("suffix", [".mcap", ".bag", ".db3", ".txt"])
def test_a_text_file_instead_of_a_bag_is_named(config, tmp_path, suffix):
    text = (tmp_path / "notes").with_suffix(suffix)
    text.write_text("Dear diary, today I drove the excavator.\n" * 50)
    assert_one_error(holdfast("replay", text, "-c", config, "-o", tmp_path / "out"), 3, text)


def test_a_bag_without_the_imu_lists_the_topics_that_it_has(config, tmp_path):
    messages = [row for row in bag_messages(make_rows(seconds=1.0)) if row[0] != "imu"]
    bag = write_bag(tmp_path / "bag", "mcap", messages)
    done = holdfast("replay", bag, "-c", config, "-o", tmp_path / "out")
    assert_one_error(done, 3, bag, "has no topic 'imu'", "gnss (sensor_msgs/msg/NavSatFix)")
    assert not (tmp_path / "out").exists()


def without(short, topic, tmp_path):
    messages = [row for row in bag_messages(make_rows(seconds=4.0)) if row[0] != topic]
    return write_bag(tmp_path / f"without_{topic}", "mcap", messages)


def test_a_sensor_that_is_not_needed_to_start_is_missed_loudly_and_named_everywhere(short, config, tmp_path):
    bag, out = without(short, "lidar", tmp_path), tmp_path / "out"
    done = holdfast("replay", bag, "-c", config, "-o", out)
    assert done.code == 0, done.err
    reason = "the recording has no topic 'lidar'"
    assert done.err == f"warning: lidar: {reason}: the estimate does without it (--strict refuses)\n"
    assert f"  lidar      missing: {reason}" in done.out.splitlines()
    assert summary(out)["missing"] == {"lidar": reason}
    assert summary(out)["warnings"] == [f"lidar: {reason}"]
    assert holdfast("report", out).code == 0
    assert f"lidar: {html.escape(reason)}" in (out / "report.html").read_text()


def test_a_topic_without_a_message_is_missed_as_well(config, tmp_path):
    drive = write_csv(tmp_path / "csv", replace(make_rows(seconds=4.0), lidar=[]))
    done = holdfast("replay", drive, "-c", config, "-o", tmp_path / "out")
    assert done.code == 0
    assert "warning: lidar: topic 'lidar' holds no message: the estimate does without it" in done.err
    assert summary(tmp_path / "out")["missing"] == {"lidar": "topic 'lidar' holds no message"}


def test_strict_refuses_a_recording_that_lacks_any_topic(short, config, tmp_path):
    bag = without(short, "lidar", tmp_path)
    done = holdfast("replay", bag, "-c", config, "-o", tmp_path / "out", "--strict")
    assert_one_error(done, 3, bag, "has no topic 'lidar'")
    assert not (tmp_path / "out").exists()


def test_the_last_source_of_positions_is_needed(short, config, tmp_path):
    bag = without(short, "gnss", tmp_path)
    assert_one_error(holdfast("replay", bag, "-c", config, "-o", tmp_path / "out"), 3, "has no topic 'gnss'")
    second = {"kind": "gnss", "topic": "gnss", "frame": "lidar"}
    both = write_config(tmp_path / "both.yaml", gnss={"topic": "gnss_left"}, gnss_right=second)
    done = holdfast("replay", short, "-c", both, "-o", tmp_path / "out", "--duration", 1)
    assert "warning: gnss: the recording has no topic 'gnss_left'; did you mean 'gnss'?" in done.err


def test_a_topic_of_another_type_is_named_with_both_types(short, tmp_path):
    config = write_config(tmp_path / "config.yaml", gnss={"topic": "imu"})
    done = holdfast("replay", short, "-c", config, "-o", tmp_path / "out")
    assert_one_error(done, 3, "'imu'", "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix")


def test_a_start_beyond_the_end_is_refused(short, config, tmp_path):
    done = holdfast("replay", short, "-c", config, "-o", tmp_path / "out", "--start", 1000)
    assert_one_error(done, 3, short, "start is 1000.0 s but the recording lasts")


def test_what_came_before_a_bad_line_is_kept(drive, config, tmp_path):
    folder = tmp_path / "csv"
    folder.mkdir()
    for file in drive.iterdir():
        (folder / file.name).write_text(file.read_text())
    lines = (folder / "imu.csv").read_text().splitlines(keepends=True)
    lines[1500] = "not,a,line\n"
    (folder / "imu.csv").write_text("".join(lines))
    done = holdfast("replay", folder, "-c", config, "-o", tmp_path / "out")
    assert_one_error(done, 3, f"{folder / 'imu.csv'}:1501", "3 columns")
    result = summary(tmp_path / "out")
    assert result["finished"] is False
    assert result["counts"]["imu"]["used"] == 1499
    assert read_tum(tmp_path / "out" / "imu_in_world.tum").stamps_ns[-1] == stamp(14.98)
