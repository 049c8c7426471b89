"""`holdfast replay` on the command line: exit codes, one clear line per mistake, and nothing lost."""

import json
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from bags import HUMBLE
from replay_command import COMMAND, assert_one_error, run_command
from small_drive import (
    EPOCH_NS,
    FILES,
    SECONDS,
    bag_messages,
    config_text,
    events,
    holdfast,
    stamp,
    summary,
    write_config,
)

from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.tum import read_tum

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


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf"])
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
    (("--outage", "gnss=9:3"), "must start at 0 s or later, and end after it starts"),
    (("--outage", "gnss=-12:30"), "must start at 0 s or later, and end after it starts"),
    (("--hold-out", "gnss=2", "--hold-out", "gnss=3"), "--hold-out gnss=3: gnss is given twice"),
    (("--hold-out", "gps=2"), "--hold-out gps=2: sensor 'gps' is not configured (allowed: imu, gnss, lidar)"),
    (("--outage", "gnss_right=1:2"), "--outage gnss_right=1:2: sensor 'gnss_right' is not configured (allowed: imu, "),
])  # fmt: skip
def test_a_bad_hold_out_is_refused_and_earlier_results_are_kept(short, config, tmp_path, option, words):
    kept = tmp_path / "out" / "imu_in_world.tum"
    kept.parent.mkdir()
    kept.write_text("of an earlier replay")
    assert_one_error(holdfast("replay", short, "-c", config, "-o", kept.parent, *option), 2, words)
    assert kept.read_text() == "of an earlier replay"


@pytest.mark.parametrize(("option", "words"), [
    (("--outage", "gnss=500:800"), "gnss: nothing was held back from 500 to 800 s: there is no usable message then"),
    (("--hold-out", "gnss=9999"), "gnss: nothing was held back by every 9999: there are fewer usable messages"),
])  # fmt: skip
def test_a_hold_out_that_holds_nothing_back_is_told(short, config, tmp_path, option, words):
    """An outage beyond the end of the recording was passed over without a word."""
    more = ("--outage", "gnss=0.1:0.3")  # this one does
    done = holdfast("replay", short, "-c", config, "-o", tmp_path / "out", *option, *more)
    assert done.code == 0
    assert done.err == f"warning: {words}\n"
    assert summary(tmp_path / "out")["warnings"] == [words]


def test_a_datum_of_another_site_is_told(short, config, tmp_path):
    config.write_text(config.read_text().replace('"latitude_deg": 47.4', '"latitude_deg": 49.4'))
    done = holdfast("replay", short, "-c", config, "-o", tmp_path / "out")
    assert done.code == 0
    (line,) = done.err.splitlines()
    assert line.startswith("warning: frames.datum: every fix is 222 km or more from it, the nearest at 47.4000, 8.5000")
    assert summary(tmp_path / "out")["warnings"] == [line.removeprefix("warning: ")]


def test_an_output_that_is_a_file_is_refused_and_kept(short, config, tmp_path):
    file = tmp_path / "out"
    file.write_text("mine")
    done = run_command(short, "-c", config, "-o", file)
    assert_one_error(done, 2, file, "folder")
    assert file.read_text() == "mine"


def test_an_output_that_cannot_be_made_is_named(short, config, tmp_path):
    (tmp_path / "file").touch()
    blocked = tmp_path / "file" / "out"
    assert_one_error(holdfast("replay", short, "-c", config, "-o", blocked), 2, blocked, "cannot be written")


def test_a_full_disk_ends_in_one_line_and_earlier_results_come_back(short, config, tmp_path):
    out = tmp_path / "out"
    assert holdfast("replay", short, "-c", config, "-o", out).code == 0
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    done = subprocess.run(
        [*COMMAND, short, "-c", config, "-o", out],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (400, 400)),
    )
    assert_one_error(done, 2, out, "cannot be written (File too large)")
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    assert [file.name for file in tmp_path.iterdir() if file.name.startswith(".")] == []


def test_no_file_of_an_earlier_replay_stays_in_the_output_folder(short, tmp_path):
    out = tmp_path / "out"
    with_base = write_config(tmp_path / "with_base.yaml", base=True)
    assert holdfast("replay", short, "-c", with_base, "-o", out).code == 0
    assert holdfast("report", out).code == 0
    assert {"base_in_world.tum", "report.html", "report.json"} < {file.name for file in out.iterdir()}
    assert holdfast("replay", short, "-c", write_config(tmp_path / "config.yaml"), "-o", out).code == 0
    assert {file.name for file in out.iterdir()} == FILES


@pytest.mark.parametrize("inside", ["", "out", "bag.mcap", "bag.mcap/out"])
def test_replay_refuses_to_write_into_the_recording(short, config, inside, tmp_path):
    bag = shutil.copytree(short, tmp_path / "bag")
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    done = holdfast("replay", bag, "-c", config, "-o", bag / inside)
    assert_one_error(done, 2, bag, "give an output outside" if inside.endswith("out") else "output")
    assert {file.name: file.read_bytes() for file in bag.iterdir()} == before


def test_a_missing_option_is_named(short, config):
    done = holdfast("replay", short, "-c", config)
    assert done.code == 2
    assert "Missing option '-o'" in done.err


# --- what was learnt --------------------------------------------------------------------------------------------------


def test_what_was_learnt_is_written_read_again_and_told(drive, config, tmp_path):
    learnt, out = tmp_path / "learnt.json", tmp_path / "out"
    assert holdfast("replay", drive, "-c", config, "-o", out, "--learnt", learnt).code == 0
    first = json.loads(learnt.read_text())
    assert first["schema_version"] == 1 and first["learnt"]["odometries"]["lidar"]["translation_noise"]
    told = {(row["sensor"], row["what"]) for row in summary(out)["learnt"]}
    assert {("lidar", "clock"), ("lidar", "mounting, about its z"), ("gnss", "clock")} <= told
    assert holdfast("replay", drive, "-c", config, "-o", out, "--learnt", learnt, "--duration", 4).code == 0
    second = json.loads(learnt.read_text())
    noises = [one["learnt"]["odometries"]["lidar"]["translation_noise"]["log_mean"] for one in (first, second)]
    assert noises[0] != noises[1] and noises[1] == pytest.approx(noises[0], abs=0.7)
    without = holdfast("replay", drive, "-c", config, "-o", out, "--duration", 4)
    assert without.code == 0 and json.loads(learnt.read_text()) == second


def test_a_file_of_what_was_learnt_that_is_none_is_one_line_and_left_as_it_is(drive, config, tmp_path):
    learnt, out = tmp_path / "learnt.json", tmp_path / "out"
    learnt.write_text("sensors: {}\n")
    done = holdfast("replay", drive, "-c", config, "-o", out, "--learnt", learnt)
    assert_one_error(done, 2, learnt, "configured: missing", "allowed: a file that --learnt has written")
    assert learnt.read_text() == "sensors: {}\n"
    assert_one_error(holdfast("replay", drive, "-c", config, "-o", out, "--learnt", out / "a.json"), 2, "is replaced")
    assert_one_error(holdfast("replay", drive, "-c", config, "-o", out, "--learnt", config), 2, "which is read")


def test_what_was_learnt_until_an_interrupt_is_written(drive, config, tmp_path):
    learnt = tmp_path / "learnt.json"
    more = "--rate", "1", "--learnt", learnt
    code, _, _ = interrupted_replay(signal.SIGINT, drive, "-c", config, "-o", tmp_path / "out", *more)
    assert code == 130
    assert json.loads(learnt.read_text())["schema_version"] == 1


# --- 130: interrupted -------------------------------------------------------------------------------------------------


def interrupted_replay(number, *arguments):
    """Send a signal to a replay that has begun to write; return exit code, stdout and stderr."""
    heard = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it would be ignored, and that is inherited
    process = subprocess.Popen(
        [*COMMAND, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    signal.signal(signal.SIGHUP, heard)
    track = arguments[arguments.index("-o") + 1] / "imu_in_world.tum"
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline and not (track.exists() and track.stat().st_size):
        time.sleep(0.02)
    process.send_signal(number)
    stdout, stderr = process.communicate(timeout=30)
    return process.returncode, stdout, stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupt_in_the_middle_keeps_what_was_done_and_says_where(drive, config, tmp_path, number):
    out = tmp_path / "out"
    code, stdout, stderr = interrupted_replay(number, drive, "-c", config, "-o", out, "--rate", "1")
    assert code == 128 + number
    # after the end of the line in which the terminal shows ^C
    assert stderr.strip() == f"interrupted: what was done until then is in {out}"
    assert stdout == ""
    result = summary(out)
    assert result["finished"] is False
    assert result["initialised"] is True
    used = result["counts"]["imu"]["used"]
    assert 100 < used < SECONDS * 100
    for file in out.glob("*.tum"):
        assert file.read_bytes().endswith(b"\n") or not file.stat().st_size
    assert read_tum(out / "imu_in_world.tum").stamps_ns[-1] == EPOCH_NS + (used - 1) * 10_000_000
    assert "initialised" in [event["kind"] for event in events(out)]
    reread = run_info(out / "estimates.mcap")
    assert reread.returncode == 0
    assert "/holdfast/odometry/world" in reread.stdout


def test_a_kill_leaves_what_was_written_and_the_next_replay_replaces_it(drive, short, config, tmp_path):
    out = tmp_path / "out"
    code, _, _ = interrupted_replay(signal.SIGKILL, drive, "-c", config, "-o", out, "--rate", "1")
    assert code == -signal.SIGKILL
    assert len(read_tum(out / "imu_in_world.tum").stamps_ns) >= 64
    assert holdfast("replay", short, "-c", config, "-o", out).code == 0
    assert {file.name for file in out.iterdir()} == FILES


def run_info(path):
    command = [*COMMAND[:-1], "info", str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def test_help_names_every_option():
    text = holdfast("replay", "--help").out
    for option in ("--config", "--output", "--start", "--duration", "--rate", "--hold-out", "--outage"):
        assert option in text
