"""`holdfast replay` on the command line: exit codes, one clear line per mistake, and nothing lost."""

import html
import json
import resource
import shutil
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


def test_where_the_imu_is_missing_too_gnss_is_not_said_to_be_all_that_is_missing(rows, tmp_path):
    drive = write_csv(tmp_path / "csv", replace(rows, imu=[], gnss=[]))
    config = write_config(tmp_path / "config.yaml", datum=False)
    done = holdfast("replay", drive, "-c", config, "-o", tmp_path / "out")
    words = "no usable IMU sample has come, and no usable position has come. Received: imu: nothing; gnss: nothing"
    assert_one_error(done, 4, drive, "never started", words)


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
