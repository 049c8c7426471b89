"""`holdfast bench realtime` measures what it prints, and refuses what it cannot do in one line."""

import json
import subprocess
import sys

import pytest
from engine import Drive

from holdfast.cli.bench_realtime import check

pytestmark = pytest.mark.slow

COMMAND = [sys.executable, "-c", "from holdfast.cli import main; main()", "bench", "realtime"]


def bench(*arguments):
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=120)


@pytest.fixture(scope="module")
def result(drive: Drive, tmp_path_factory):
    path = tmp_path_factory.mktemp("bench") / "result.json"
    config = drive.folder / "config.yaml"
    done = bench("--recording", drive.folder, "-c", config, "--duration", "5", "--json", path)
    assert done.returncode == 0, done.stderr
    return done.stdout, json.loads(path.read_text(encoding="utf-8"))


def test_each_run_has_its_times_and_its_floor(result):
    _, found = result
    assert set(found["runs"]) == {"busy", "idle", "back_to_back", "cabin_only"}
    for run in found["runs"].values():
        imu, floor = run["imu_us"], run["floor_us"]
        assert 0.0 < imu["median"] <= imu["p99"] <= imu["p99.9"] <= imu["max"]
        assert floor["median"] > 0.0
        assert run["ratio_to_floor"]["median"] == pytest.approx(imu["median"] / floor["median"])
        assert 0.0 < run["cpu"]["imu_path"] <= 1.1


def test_the_gate_names_what_is_slower_than_the_floor_and_lets_the_rest_through(capsys):
    check({"median": 0.99, "p99": 1.0})
    with pytest.raises(SystemExit) as ended:
        check({"median": 0.99, "p99": 1.5})
    assert ended.value.code == 1
    assert capsys.readouterr().err == "error: too slow: 1.50 x the floor at p99 (allowed: 1)\n"


def test_an_idle_optimiser_updates_seldom_and_its_state_is_old(result):
    _, found = result
    busy, idle = found["runs"]["busy"], found["runs"]["idle"]
    assert idle["update_ms"]["count"] < 25  # a node each half second
    assert idle["age_ms"]["median"] > 200.0
    # 45 measurements a second, of which an update takes in the more the busier the machine is
    assert busy["update_ms"]["count"] > idle["update_ms"]["count"]
    assert busy["cpu"]["optimiser"] > idle["cpu"]["optimiser"]


def test_what_is_printed_fits_into_a_terminal(result):
    printed, _ = result
    assert "optimiser busy" in printed
    assert "x the floor at the median" in printed
    assert all(len(line) <= 120 for line in printed.splitlines())


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--duration", "-1"], "--duration -1: must be > 0"),
        (["--recording", "nowhere"], "--recording and -c belong together"),
        (["--json", "no/such/folder/x.json"], "its folder does not exist"),
    ],
)
def test_a_mistake_is_one_line(arguments, reason):
    done = bench(*arguments)
    assert done.returncode == 2
    assert reason in done.stderr
    assert len(done.stderr.splitlines()) == 1
