"""However a process ends: none is left behind, and no shared memory."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from engine import play, wait_for

from holdfast.estimator.estimator import Estimator
from holdfast.kernel.compiling import FOLDER, MESSAGE

KEEPER = """
import sys, time
import holdfast
engine = holdfast.RealtimeEstimator(holdfast.load_config(sys.argv[1]))
engine.wait_until_ready()
print(engine.optimiser_pid, flush=True)
time.sleep(60)
"""
COMMAND = [sys.executable, "-c", "from holdfast.cli import main; main()"]


def replay(drive, folder):
    config = drive.folder / "config.yaml"
    return [*COMMAND, "replay", str(drive.folder), "-c", str(config), "-o", str(folder), "--realtime"]


def is_running(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.fixture
def keeper(drive):
    """A program with an engine, and the pid of its optimiser."""
    process = subprocess.Popen(
        [sys.executable, "-c", KEEPER, str(drive.folder / "config.yaml")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    pid = int(process.stdout.readline())
    yield process, pid
    process.kill()
    process.wait()
    if is_running(pid):
        os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize("is_stopped", [False, True])
def test_the_optimiser_ends_with_a_program_that_is_killed(keeper, is_stopped):
    process, pid = keeper
    if is_stopped:
        os.kill(pid, signal.SIGSTOP)
    assert is_running(pid)
    process.kill()
    wait_for(lambda: not is_running(pid), timeout_s=10.0)
    assert process.stderr.read() == ""


def test_the_shared_memory_has_no_name_that_could_be_left(keeper):
    process, pid = keeper
    for one in (process.pid, pid):
        mapped = Path(f"/proc/{one}/maps").read_text(encoding="utf-8")
        assert "memfd:holdfast (deleted)" in mapped
        assert "/dev/shm" not in mapped
    os.kill(pid, signal.SIGKILL)
    process.kill()
    process.wait()
    assert not [path for path in Path("/dev/shm").glob("*holdfast*") if path.is_file()]  # fuzzers have folders there


def test_a_program_that_ends_without_closing_leaves_nothing(drive):
    code = KEEPER.replace("time.sleep(60)", "")
    done = subprocess.run(
        [sys.executable, "-c", code, str(drive.folder / "config.yaml")],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    wait_for(lambda: not is_running(int(done.stdout)), timeout_s=10.0)


def children(pid):
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False)
    return [int(line) for line in found.stdout.split()]


def test_ctrl_c_in_a_replay_writes_what_came_and_ends_both(drive, tmp_path):
    process = subprocess.Popen(
        replay(drive, tmp_path),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    track = tmp_path / "imu_in_world.tum"
    updates = tmp_path / "optimized_in_world.tum"
    wait_for(lambda: track.exists() and track.stat().st_size > 0, timeout_s=60.0)
    # the report of an update, with its counts, comes before the update that follows
    wait_for(lambda: updates.exists() and updates.read_bytes().count(b"\n") >= 3, timeout_s=60.0)
    others = children(process.pid)
    assert others
    process.send_signal(signal.SIGINT)
    _, printed = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "Traceback" not in printed
    assert not any(is_running(pid) for pid in others)
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary["finished"] is False
    assert summary["counts"]["gnss"]["used"] > 0
    lines = track.read_text(encoding="utf-8").splitlines()
    assert len(lines[-1].split()) == 8
    for line in (tmp_path / "events.jsonl").read_text(encoding="utf-8").splitlines():
        json.loads(line)


@pytest.mark.slow
def test_a_realtime_replay_comes_to_the_same_summary(drive, tmp_path):
    done = subprocess.run(
        [*replay(drive, tmp_path), "--rate", "4", "--duration", "10"],
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary["finished"] is True
    assert summary["counts"]["imu"] == {"used": 1000}
    assert summary["events"]["initialised"] == 1
    assert summary["events"].get("optimiser_fault", 0) == 0
    # how many measurements an update takes in is a matter of the machine's load, how many are taken in is none
    inline = Estimator(drive.config)
    play(inline, drive.until(10.0))
    for sensor in ("gnss", "gnss_right", "heading", "lidar"):
        counts = {str(outcome): count for (name, outcome), count in inline.counts.items() if name == sensor}
        assert sum(summary["counts"][sensor].values()) == pytest.approx(sum(counts.values()), abs=1)
        assert summary["counts"][sensor]["used"] > 0.9 * counts["used"] > 0
    assert summary["timing"]["update_ms"]["count"] > 0
    assert summary["timing"]["wall_s"] > 2.4


@pytest.mark.slow
def test_each_process_runs_where_the_configuration_puts_it(drive):
    allowed = sorted(os.sched_getaffinity(0))
    if len(allowed) < 2:
        pytest.skip("one core")
    code = (
        "import os, sys, holdfast\n"
        "from holdfast.errors import ConfigError\n"
        "config = holdfast.load_config(sys.argv[1])\n"
        "everywhere = os.sched_getaffinity(0)\n"
        "for settings in sys.argv[2:]:\n"
        "    os.sched_setaffinity(0, everywhere)\n"
        "    values = dict(pair.split('=') for pair in settings.split())\n"
        "    realtime = config.realtime.model_copy(update={name: int(value) for name, value in values.items()})\n"
        "    try:\n"
        "        with holdfast.RealtimeEstimator(config.model_copy(update={'realtime': realtime})) as engine:\n"
        "            engine.wait_until_ready()\n"
        "            pid = engine.optimiser_pid\n"
        "            here, there = (sorted(os.sched_getaffinity(one)) for one in (0, pid))\n"
        "            print(here, there, os.getpriority(os.PRIO_PROCESS, pid))\n"
        "    except ConfigError as error:\n"
        "        print(error)\n"
    )
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    expected = {
        "": f"{allowed} {allowed} {nice}",
        f"imu_core={allowed[0]} optimiser_nice=2": f"[{allowed[0]}] {allowed} {min(nice + 2, 19)}",
        f"optimiser_core={allowed[1]}": f"{allowed} [{allowed[1]}] {nice}",
    }
    done = subprocess.run(
        [sys.executable, "-c", code, str(drive.folder / "config.yaml"), *expected, "imu_core=4096"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    *placed, refused = done.stdout.splitlines()
    assert dict(zip(expected, placed, strict=True)) == expected
    assert "realtime.imu_core = 4096: must be one of" in refused


def test_the_example_runs_without_a_guard_for_its_main_module(drive):
    example = Path(__file__).parents[2] / "examples" / "realtime.py"
    assert len(example.read_text(encoding="utf-8").splitlines()) <= 32
    process = subprocess.Popen(
        [sys.executable, "-u", str(example), str(drive.folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        line = next(line for line in process.stdout if " m +- " in line)
    finally:
        process.kill()
        process.wait()
    east, north, up, *_ = (float(word) for word in line.split()[:3])
    assert abs(east) + abs(north) + abs(up) < 20.0  # the machine has hardly left the datum
    assert process.stderr.read() == ""


PLAYER = """
import sys
import holdfast
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
config = holdfast.load_config(sys.argv[1] + "/config.yaml")
with holdfast.RealtimeEstimator(config) as engine, open_recording(sys.argv[1]) as recording:
    engine.wait_until_ready()
    for count, message in enumerate(recording.read(subscriptions(config), 0.0, 8.0)):
        engine.process(message)
        if count % 10 == 0:
            engine.flush()
    print(engine.initialised, dict(engine.event_counts).get("optimiser_fault", 0))
"""


def test_an_engine_whose_cache_cannot_be_written_runs_the_code_of_the_temporary_files_in_both(drive, tmp_path):
    """What is said where there is none yet: `tests/kernel/test_compiling.py`."""
    if FOLDER is None:
        pytest.skip("neither beside the package nor elsewhere can code be kept, so there is none to copy")
    there = {"NUMBA_CACHE_DIR": "/proc/nowhere", "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", "from holdfast.kernel.compiling import FOLDER; print(FOLDER)"]
    found = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ | there)
    assert found.stderr == f"{MESSAGE}\n"
    folder = Path(found.stdout.strip())
    assert folder.is_relative_to(tmp_path) and not list(folder.iterdir())
    shutil.copytree(FOLDER, folder, dirs_exist_ok=True)  # compiled for this process; to compile anew takes a minute
    before = contents(folder)
    assert before
    done = subprocess.run(
        [sys.executable, "-c", PLAYER, str(drive.folder)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | there,
        timeout=1200,
    )
    assert (done.stdout, done.stderr) == ("True 0\n", "")
    assert contents(folder) == before  # neither process compiled


def contents(folder):
    """The files below a folder, and when each was written; numba writes whatever it compiles."""
    return {file: file.stat().st_mtime_ns for file in folder.rglob("*") if file.is_file()}
