"""`holdfast replay` on the command line: exit codes, one clear line per mistake, and nothing lost."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from bags import HUMBLE, write_bag
from small_drive import (
    EPOCH_NS,
    FILES,
    SECONDS,
    bag_messages,
    config_text,
    events,
    holdfast,
    make_rows,
    stamp,
    summary,
    write_config,
    write_csv,
    write_mcap,
)

from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.tum import read_tum

COMMAND = [sys.executable, "-c", "from holdfast.cli import main; main()", "replay"]


def run_command(*arguments):
    """Run the real command in a process of its own, with its output in a pipe."""
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=60)


@pytest.fixture(scope="session")
def rows():
    return make_rows()


@pytest.fixture(scope="session")
def drive(tmp_path_factory, rows):
    return write_csv(tmp_path_factory.mktemp("drive") / "csv", rows)


@pytest.fixture(scope="session")
def short(tmp_path_factory):
    """Four seconds in a bag: enough to start."""
    return write_mcap(tmp_path_factory.mktemp("drive") / "bag", make_rows(seconds=4.0))


@pytest.fixture
def config(tmp_path):
    return write_config(tmp_path / "config.yaml")


def assert_one_error(done, code, *words):
    """One line on stderr, with the words in it, nothing on stdout, no traceback."""
    lines = (done.err if hasattr(done, "err") else done.stderr).splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    for word in words:
        assert str(word) in lines[0]
    assert (done.code if hasattr(done, "code") else done.returncode) == code
    assert (done.out if hasattr(done, "out") else done.stdout) == ""


# --- 0: done ----------------------------------------------------------------------------------------------------------


def test_a_pipe_gets_plain_lines_and_a_silent_stderr(short, config, tmp_path):
    done = run_command(short, "-c", config, "-o", tmp_path / "out")
    assert done.returncode == 0
    assert done.stderr == ""
    assert "\x1b" not in done.stdout
    assert done.stdout.isascii()
    lines = done.stdout.splitlines()
    assert "x real time" in lines[0]
    assert any(line.split()[0] == "imu" and "400 used" in line for line in lines)
    assert lines[-1] == f"written to {tmp_path / 'out'}"


def test_a_folder_for_the_output_is_made_with_its_parents(short, config, tmp_path):
    assert holdfast("replay", short, "-c", config, "-o", tmp_path / "a" / "b").code == 0
    assert {file.name for file in (tmp_path / "a" / "b").iterdir()} == FILES


def test_rate_paces_the_replay(short, config, tmp_path):
    began = time.perf_counter()
    assert holdfast("replay", short, "-c", config, "-o", tmp_path / "out", "--rate", 2).code == 0
    assert time.perf_counter() - began > 0.5 * 3.9
    assert summary(tmp_path / "out")["timing"]["real_time_factor"] == pytest.approx(2.0, rel=0.2)


def test_a_cut_off_bag_is_replayed_up_to_the_cut_with_a_warning(tmp_path, rows, config):
    bag, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    with McapWriter(bag) as writer:  # its chunks are a quarter of a megabyte
        for topic, arrival, message in bag_messages(rows):
            writer.write(topic, bytes(HUMBLE.serialize_cdr(message, message.__msgtype__)), message.__msgtype__, arrival)
    whole = bag.read_bytes()
    cut.write_bytes(whole[: len(whole) * 6 // 10])
    done = holdfast("replay", cut, "-c", config, "-o", tmp_path / "out")
    assert done.code == 0
    [warning] = done.err.splitlines()
    assert warning.startswith(f"warning: {cut}: is cut off")
    result = summary(tmp_path / "out")
    assert result["finished"] is True
    assert result["warnings"] == [warning.removeprefix("warning: ")]
    assert 0.3 * SECONDS * 100 < sum(result["counts"]["imu"].values()) < 0.9 * SECONDS * 100
    track = read_tum(tmp_path / "out" / "imu_in_world.tum").stamps_ns
    assert stamp(0.3 * SECONDS) < track[-1] < stamp(0.9 * SECONDS)


# --- 2: bad usage or configuration ------------------------------------------------------------------------------------


def test_a_mistyped_key_is_named_with_file_line_and_remedy(short, tmp_path):
    config = tmp_path / "config.yaml"
    config.write_text(config_text().replace('"topic": "gnss"', '"topik": "gnss"'))
    line = next(n for n, text in enumerate(config.read_text().splitlines(), start=1) if "topik" in text)
    done = run_command(short, "-c", config, "-o", tmp_path / "out")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert all(text.startswith(f"error: {config}:") for text in done.stderr.splitlines())
    assert f"error: {config}:{line}" in done.stderr
    assert "topik" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_missing_configuration_is_named(short, tmp_path):
    done = holdfast("replay", short, "-c", tmp_path / "none.yaml", "-o", tmp_path / "out")
    assert_one_error(done, 2, tmp_path / "none.yaml", "no such file")


@pytest.mark.parametrize("rate", ["0", "-1", "nan"])
def test_rate_must_be_positive(short, config, tmp_path, rate):
    done = holdfast("replay", short, "-c", config, "-o", tmp_path / "out", "--rate", rate)
    assert_one_error(done, 2, f"--rate {rate}: must be > 0")


@pytest.mark.parametrize(("option", "words"), [
    (("--start", "-1"), "--start -1: must be >= 0"),
    (("--start", "nan"), "--start nan: must be >= 0"),
    (("--duration", "0"), "--duration 0: must be > 0"),
    (("--duration", "nan"), "--duration nan: must be > 0"),
])  # fmt: skip
def test_a_window_that_no_recording_has_is_refused(short, config, tmp_path, option, words):
    assert_one_error(holdfast("replay", short, "-c", config, "-o", tmp_path / "out", *option), 2, words)


@pytest.mark.parametrize(("option", "words"), [
    (("--hold-out", "nonsense"), "must be SENSOR=N"),
    (("--hold-out", "gnss=1"), "must be SENSOR=N with N >= 2"),
    (("--outage", "gnss=5"), "must be SENSOR=START:END"),
    (("--outage", "gnss=9:3"), "must end after it starts"),
    (("--hold-out", "gps=2"), "sensor 'gps' is not configured (allowed: imu, gnss, lidar)"),
    (("--outage", "gnss_right=1:2"), "sensor 'gnss_right' is not configured (allowed: imu, gnss, lidar)"),
])  # fmt: skip
def test_a_bad_hold_out_is_refused_and_earlier_results_are_kept(short, config, tmp_path, option, words):
    kept = tmp_path / "out" / "imu_in_world.tum"
    kept.parent.mkdir()
    kept.write_text("of an earlier replay")
    assert_one_error(holdfast("replay", short, "-c", config, "-o", kept.parent, *option), 2, words)
    assert kept.read_text() == "of an earlier replay"


def test_an_output_that_is_a_file_is_refused_and_kept(short, config, tmp_path):
    file = tmp_path / "out"
    file.write_text("mine")
    done = run_command(short, "-c", config, "-o", file)
    assert_one_error(done, 2, file, "folder")
    assert file.read_text() == "mine"


def test_an_output_file_that_cannot_be_written_is_named(short, config, tmp_path):
    blocked = tmp_path / "out" / "events.jsonl"
    blocked.mkdir(parents=True)
    assert_one_error(holdfast("replay", short, "-c", config, "-o", tmp_path / "out"), 2, blocked, "cannot be written")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a full disk is played by /dev/full")
@pytest.mark.parametrize("name", ["imu_in_world.tum", "estimates.mcap"])
def test_a_full_disk_ends_in_one_line(short, config, tmp_path, name):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to("/dev/full")
    done = run_command(short, "-c", config, "-o", tmp_path / "out")
    assert_one_error(done, 2, tmp_path / "out", "cannot be written (No space left on device)")


def test_a_missing_option_is_named(short, config):
    done = holdfast("replay", short, "-c", config)
    assert done.code == 2
    assert "Missing option '-o'" in done.err


# --- 3: unreadable recording ------------------------------------------------------------------------------------------


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


# --- 4: never initialised ---------------------------------------------------------------------------------------------


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
    assert_one_error(done, 4, "never started", "is the accelerometer in g?")
    assert_outputs_say_why(tmp_path / "out", "is the accelerometer in g?")


def test_standstill_without_a_heading_says_what_to_give(rows, tmp_path):
    drive = write_csv(tmp_path / "csv", rows)
    settings = json.loads(config_text())
    del settings["initialisation"]
    (tmp_path / "config.yaml").write_text(json.dumps(settings))
    done = holdfast("replay", drive, "-c", tmp_path / "config.yaml", "-o", tmp_path / "out", "--duration", 2.5)
    assert_one_error(done, 4, "never started", "initialisation.heading_deg")


# --- 130: interrupted -------------------------------------------------------------------------------------------------


def test_ctrl_c_in_the_middle_keeps_what_was_done(drive, config, tmp_path):
    out = tmp_path / "out"
    process = subprocess.Popen(
        [*COMMAND, drive, "-c", config, "-o", out, "--rate", "1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a shell that runs the tests in the background leaves SIGINT ignored
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 (runs no thread)
    )
    track = out / "imu_in_world.tum"
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline and not (track.exists() and track.stat().st_size):
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=30)
    assert process.returncode == 130
    assert stderr.split() == ["interrupted"]  # after the end of the line in which the terminal shows ^C
    assert stdout == ""
    result = summary(out)
    assert result["finished"] is False
    assert result["initialised"] is True
    used = result["counts"]["imu"]["used"]
    assert 100 < used < SECONDS * 100
    for file in out.glob("*.tum"):
        assert file.read_bytes().endswith(b"\n") or not file.stat().st_size
    assert read_tum(track).stamps_ns[-1] == EPOCH_NS + (used - 1) * 10_000_000
    assert "initialised" in [event["kind"] for event in events(out)]
    reread = run_info(out / "estimates.mcap")
    assert reread.returncode == 0
    assert "/holdfast/odometry/world" in reread.stdout


def run_info(path):
    command = [*COMMAND[:-1], "info", str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def test_help_names_every_option():
    text = holdfast("replay", "--help").out
    for option in ("--config", "--output", "--start", "--duration", "--rate", "--hold-out", "--outage"):
        assert option in text
