"""`holdfast calibrate` on the command line, and `holdfast.calibrate`: a file with comments in, one that fits out."""

import json
import os
import pty
import signal
import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from small_drive import config_text, holdfast, make_rows, write_mcap

import holdfast as package
from holdfast.config.load import load_config, parse_config, resolved_yaml
from holdfast.errors import ConfigError

NOISY = {"imu": {"gyroscope_noise_density": 1e-6}, "lidar": {"translation_sigma_m": 0.3}}


def written_by_hand(path, **sensors):
    """The configuration of the small drive in YAML with comments; the noise that it gives is wrong."""
    text = resolved_yaml(parse_config(config_text(**sensors)), given_only=True)
    text = "# my machine\n" + text.replace("  lidar:\n", "  # on the roof\n  lidar:   # a good one\n")
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrate")
    return write_mcap(folder / os.fsdecode(b"b\xe4g"), make_rows(seconds=15.0)), written_by_hand(
        folder / "machine.yaml", **NOISY
    )


@pytest.fixture(scope="module")
def calibrated(drive, tmp_path_factory):
    recording, config = drive
    output = tmp_path_factory.mktemp("out") / "machine_calibrated.yaml"
    return holdfast("calibrate", recording, "-c", config, "-o", output), output


def test_the_file_is_written_with_the_comments_of_before_and_one_above_each_change(drive, calibrated):
    done, output = calibrated
    assert done.code == 0, done.err
    before, after = drive[1].read_text(), output.read_text()
    now = load_config(output)
    changed = [line for line in after.splitlines() if "# calibrated: " in line]
    assert now != parse_config(before)
    assert changed and all(" -> " in line and "sigma" in line and r"from b\udce4g" in line for line in changed)
    kept = iter(after.splitlines())
    assert all(line in kept for line in before.splitlines() if "sigma_m:" not in line and "density:" not in line)


def test_wrong_noise_of_an_odometry_is_told_on_the_screen_and_corrected(calibrated):
    done, output = calibrated
    assert "sensors.lidar.translation_sigma_m: lidar: 0.3 -> " in done.out
    assert load_config(output).sensors["lidar"].translation_sigma_m < 0.1


def test_what_could_not_be_seen_is_said(calibrated):
    done, _ = calibrated
    assert "kept, not observable" in done.out or "kept, as configured" in done.out


def test_a_page_needs_no_network_and_holds_every_number(calibrated):
    pytest.importorskip("plotly")
    _, output = calibrated
    page, numbers = output.with_suffix(".html").read_text(), json.loads(output.with_suffix(".json").read_text())
    assert 'http-equiv="Content-Security-Policy" content="default-src \'none\'' in page
    keys = [row[1] for table in numbers["tables"].values() if "key" in table["columns"] for row in table["rows"]]
    assert "sensors.lidar.translation_sigma_m" in keys and "sensors.gnss.time_offset_s" in keys
    assert numbers["tables"]["held_out"]["rows"][0][0] == "as configured"


@pytest.mark.slow
def test_python_finds_the_same_and_the_same_twice(drive, calibrated):
    recording, config = drive
    found = package.calibrate(recording, config)
    assert found.text == calibrated[1].read_text()
    assert found.config == load_config(calibrated[1])
    assert any(one.is_written and one.sigma > 0.0 for one in found.estimates)


def test_every_mistake_is_one_line_before_any_work(drive, tmp_path):
    recording, config = drive
    output = tmp_path / "out.yaml"
    there = tmp_path / "there.yaml"
    there.write_text("# mine\n")
    for arguments, line in (
        ((tmp_path / "no.mcap", "-c", config, "-o", output), "no such file or folder"),
        ((recording, "-c", tmp_path / "no.yaml", "-o", output), "no such file"),
        ((recording, "-c", config, "-o", there), "exists already: give another name, or --force"),
        ((recording, "-c", config, "-o", config, "--force"), "which is read: give another output"),
        ((recording, "-c", config, "-o", tmp_path / "out.txt"), "the name must end in .yaml"),
        ((recording, "-c", config, "-o", tmp_path / "no" / "out.yaml"), "its folder does not exist"),
        ((recording, "-c", config, "-o", output, "--hold-out", "1"), "must be an integer >= 2"),
    ):
        done = holdfast("calibrate", *arguments)
        assert done.code != 0 and done.err.count("\n") == 1 and line in done.err, done.err
    assert there.read_text() == "# mine\n" and not output.exists()


def test_a_drive_shorter_than_the_window_tells_nothing_of_an_odometry(drive, tmp_path):
    """It ended in an IndexError: no node had left the window."""
    short = write_mcap(tmp_path / "bag", make_rows(seconds=1.6))
    done = holdfast("calibrate", short, "-c", drive[1], "-o", tmp_path / "out.yaml")
    assert done.code == 0, done.err
    assert "too little motion with trusted GNSS: lidar (rotation_sigma_rad)" in done.out


def test_a_recording_that_lacks_the_imu_is_named(drive, tmp_path):
    recording, _ = drive
    config = written_by_hand(tmp_path / "other.yaml", imu={"topic": "other"})
    done = holdfast("calibrate", recording, "-c", config, "-o", tmp_path / "out.yaml")
    assert done.code != 0 and "has no topic 'other'" in done.err
    assert not (tmp_path / "out.yaml").exists()


def test_ctrl_c_leaves_nothing_half_written(drive, tmp_path):
    recording, config = drive
    output = tmp_path / "out.yaml"
    terminal, other_end = pty.openpty()
    command = [sys.executable, "-m", "holdfast", "calibrate", recording, "-c", config, "-o", output]
    process = subprocess.Popen(list(map(str, command)), stderr=other_end, env=os.environ | {"TERM": "xterm"})
    os.close(other_end)
    printed = os.read(terminal, 1)  # its progress has begun
    process.send_signal(signal.SIGINT)
    with suppress(OSError):  # a terminal ends so when nobody writes to it any more
        while part := os.read(terminal, 1 << 16):
            printed += part
    assert process.wait(timeout=120) == 130 and b"interrupted" in printed
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_late_keeps_what_was_found(drive, tmp_path, monkeypatch):
    """What held-out fixes did not judge is told and not written."""
    module = import_module("holdfast.calibration.calibrate")
    run = module._Runs.run

    def press(runs, title, *args):
        if title.startswith("held out: noise"):
            os.kill(os.getpid(), signal.SIGINT)
        return run(runs, title, *args)

    monkeypatch.setattr(module._Runs, "run", press)
    output = tmp_path / "out.yaml"
    done = holdfast("calibrate", *(drive[0], "-c", drive[1], "-o", output))
    assert done.code == 130 and done.err.strip().endswith(f"interrupted: what was found until then is in {output}")
    assert "sensors.lidar.translation_sigma_m: lidar: 0.3 -> " in done.out and ", not written" in done.out
    assert load_config(output) == load_config(drive[1])
    tables = json.loads(output.with_suffix(".json").read_text())["tables"]
    rows = {row[1]: row for table in tables.values() if "key" in table["columns"] for row in table["rows"]}
    lidar = rows["sensors.lidar.translation_sigma_m"]
    assert lidar[3] == 0.3 and lidar[4] < 0.1 and lidar[-1] == "it ended before held-out fixes could judge it"


def test_what_was_found_is_written_although_the_page_cannot_be(drive, tmp_path, monkeypatch):
    """The page came first: on a full disk the work of many minutes was lost with it."""
    found = SimpleNamespace(text="# found\n", estimates=[], held_out=[], failure=None)

    def full(*_):
        raise ConfigError("c.html: cannot be written (No space left on device)")

    monkeypatch.setattr("holdfast.calibration.calibrate.calibrated", lambda *_, **__: found)
    monkeypatch.setattr("holdfast.calibration.page.calibration_page", lambda *_: None)
    monkeypatch.setattr("holdfast.report.page.write_page", full)
    done = holdfast("calibrate", *(drive[0], "-c", drive[1], "-o", tmp_path / "c.yaml"))
    assert (done.code, done.err) == (2, "error: c.html: cannot be written (No space left on device)\n")
    assert (tmp_path / "c.yaml").read_text() == "# found\n"
