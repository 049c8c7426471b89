"""`holdfast lidar-odometry` that is interrupted or killed: what was written is kept, and no process is left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from bags import HUMBLE, bare, write_bag
from cloud_bags import convert, messages, read

from holdfast.errors import EstimatorError
from holdfast.lidar_odometry import runner
from holdfast.lidar_odometry.process import ScanProcess
from holdfast.recording.source import open_recording

pytest.importorskip("small_gicp")

COMMAND = """
import holdfast.cli as cli
from holdfast.cli.lidar_odometry import lidar_odometry
cli.holdfast = lidar_odometry
cli.main()
"""


def test_a_killed_process_is_one_line_and_what_was_written_is_kept(bag, tmp_path, monkeypatch):
    class Doomed(ScanProcess):
        asked = 0

        def take(self, timeout_s=None):
            self.asked += 1
            if self.asked == 4:
                os.kill(self.pid, signal.SIGKILL)
                time.sleep(0.2)
            return super().take(timeout_s)

    monkeypatch.setattr(runner, "ScanProcess", Doomed)
    with pytest.raises(EstimatorError, match="its process was killed by SIGKILL") as raised:
        convert(bag, tmp_path / "out.mcap", "--replace")
    assert "\n" not in str(raised.value)
    assert len(read(tmp_path / "out.mcap", "/lidar/odometry")) >= 3


@pytest.fixture(scope="module")
def long_bag(tmp_path_factory):
    """More sweeps than are registered before somebody interrupts."""
    return bare(write_bag(tmp_path_factory.mktemp("long") / "in", "mcap", messages(HUMBLE, number=150)))


def start(bag, out):
    """The real command in a session of its own, some chunks into its work."""
    running = subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(bag), "-o", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 30
    while not (out.exists() and out.stat().st_size > 1000) and time.monotonic() < deadline:
        assert running.poll() is None, running.communicate()
        time.sleep(0.02)
    return running


def survivors(session):
    """Processes of a session."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


def assert_nobody_survives(session):
    deadline = time.monotonic() + 10
    while survivors(session) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert survivors(session) == []


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_ctrl_c_leaves_a_readable_file_and_no_process(long_bag, tmp_path):
    running = start(long_bag, tmp_path / "out.mcap")
    os.killpg(running.pid, signal.SIGINT)
    out, err = running.communicate(timeout=30)
    assert (running.returncode, out, err.strip()) == (130, "", "interrupted")
    with open_recording(tmp_path / "out.mcap") as recording:
        assert recording.warnings == []
        assert sum(info.count for info in recording.topics) > 10
    assert_nobody_survives(running.pid)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_no_process_outlives_one_that_was_killed(long_bag, tmp_path):
    running = start(long_bag, tmp_path / "out.mcap")
    assert len(survivors(running.pid)) >= 2
    running.kill()
    running.communicate(timeout=30)
    assert_nobody_survives(running.pid)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_replay_of_scans_that_is_ended_leaves_no_process(long_bag, tmp_path, number):
    (tmp_path / "config.yaml").write_text(
        "sensors: {imu: {kind: imu, topic: /imu}, lidar: {kind: scans, topic: /points}}\n"
        "extrinsics: [{parent: imu, child: lidar, translation_m: [0, 0, 1]}]\n"
    )
    arguments = ["replay", str(long_bag), "-c", str(tmp_path / "config.yaml"), "-o", str(tmp_path / "out")]
    running = subprocess.Popen(
        [sys.executable, "-c", "from holdfast.cli import main; main()", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while len(survivors(running.pid)) < 2 and time.monotonic() < deadline:
        assert running.poll() is None, running.communicate()
        time.sleep(0.02)
    time.sleep(1.0)
    os.killpg(running.pid, number)
    _, err = running.communicate(timeout=60)
    assert running.returncode == (130 if number == signal.SIGINT else -signal.SIGKILL)
    assert "Traceback" not in err
    assert_nobody_survives(running.pid)
