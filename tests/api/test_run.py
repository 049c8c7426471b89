"""`holdfast.replay` and `holdfast.smooth` as functions: a recording in, arrays out."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from small_drive import write_config, write_mcap

import holdfast
from holdfast.recording.tum import read_tum

EXAMPLE = Path(__file__).parents[2] / "examples" / "api_example.py"


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("api")
    return write_mcap(folder / "bag"), write_config(folder / "config.yaml", base=True)


@pytest.fixture(scope="module")
def smoothed(drive, tmp_path_factory):
    return holdfast.smooth(*drive, hold_out={"gnss": 5}, output=tmp_path_factory.mktemp("out") / "smoothed")


def test_the_arrays_are_those_of_the_files(smoothed):
    for track, name in (
        (smoothed.world, "causal/imu_in_world"),
        (smoothed.odometry, "causal/imu_in_odom"),
        (smoothed.base, "causal/base_in_world"),
        (smoothed.smoothed, "imu_in_world"),
    ):
        written = read_tum(smoothed.folder / f"{name}.tum")
        assert np.array_equal(track.stamps_ns, written.stamps_ns)
        assert np.allclose(track.positions, written.positions, atol=1e-8)
        assert np.allclose(abs((track.quaternions_xyzw * written.quaternions).sum(axis=1)), 1.0)


def test_shapes_are_as_documented(smoothed):
    for track in (smoothed.world, smoothed.odometry, smoothed.smoothed):
        n = len(track)
        assert track.positions.shape == (n, 3) and track.quaternions_xyzw.shape == (n, 4)
        assert track.velocities.shape == (n, 3) and track.covariances.shape == (n, 9, 9)


def test_the_velocity_in_o_is_that_of_the_positions_in_o(smoothed):
    moved = np.gradient(smoothed.odometry.positions, smoothed.odometry.stamps_ns * 1e-9, axis=0)
    assert np.median(abs(moved - smoothed.odometry.velocities)) < 0.02


def test_events_and_summary_are_there(smoothed):
    assert any(event.kind == "initialised" for event in smoothed.events)
    assert smoothed.summary["held_out"]["batch"]["all"]["horizontal_m"]["rms"] < 0.05


def test_without_an_output_the_files_go_with_the_result(drive):
    result = holdfast.replay(*drive, duration_s=12.0)
    folder = result.folder
    assert (
        (folder / "imu_in_world.tum").exists() and result.smoothed is not None and result.smoothed.covariances is None
    )
    del result
    assert not folder.exists()


def test_a_report_is_written(smoothed, tmp_path):
    pytest.importorskip("plotly")
    assert smoothed.report(tmp_path / "page.html").stat().st_size > 10_000
    for path, words in (
        (tmp_path / "page.pdf", r"must end in \.html"),
        (None, "path: must be a path, not NoneType"),
        (tmp_path / "nodir" / "page.html", "page.html: cannot be written"),
    ):
        with pytest.raises(holdfast.ConfigError, match=words):
            smoothed.report(path)


def test_a_config_may_be_a_path_plain_data_or_a_config(drive):
    from ruamel.yaml import YAML

    path = drive[1]
    data = YAML(typ="safe").load(Path(path).read_text())
    ends = [
        holdfast.replay(drive[0], config, duration_s=8.0).world.positions[-1]
        for config in (path, str(path), data, holdfast.load_config(path))
    ]
    assert all(np.array_equal(end, ends[0]) for end in ends)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"config": 3}, "config: must be a path, a dict or a Config, not int"),
        ({"config": {1: 2}}, "config:1 1: unknown key"),
        ({"config": {"sensors": {3, 4}}}, "config: must hold text, numbers, lists and dicts alone .got {3, 4} .set"),
        ({"config": {("a", "b"): 2}}, "config: must hold text, numbers, lists and dicts alone .keys must be str"),
        ({"output": "/dev/null/out"}, "/dev/null.*: cannot be written"),
        ({"outage": {"gnss": "12"}}, r"outage\['gnss'\]: must be \(start, end\) \[s\], got '12'"),
        ({"hold_out": {"gnss": 1}}, r"hold_out\['gnss'\]: must be an integer >= 2, got 1"),
        ({"hold_out": {"gps": 2}}, r"hold_out\['gps'\]: sensor 'gps' is not configured"),
        ({"outage": {"gps": (1.0, 2.0)}}, r"outage\['gps'\]: sensor 'gps' is not configured"),
        ({"outage": {"gnss": (20.0, 10.0)}}, r"outage\['gnss'\]: must start at 0 s or later, and end after it starts"),
    ],
)
def test_a_mistaken_argument_is_named(drive, options, text):
    with pytest.raises(holdfast.ConfigError, match=text):
        holdfast.replay(drive[0], **({"config": drive[1]} | options))


def test_plain_data_may_hold_arrays(drive):
    from ruamel.yaml import YAML

    data = YAML(typ="safe").load(Path(drive[1]).read_text())
    arm = data["extrinsics"][0]["translation_m"]
    data["extrinsics"][0]["translation_m"] = np.array(arm)
    data["initialisation"]["heading_deg"] = np.float32(63.0)
    config = holdfast.replay(drive[0], data, duration_s=8.0).summary
    assert config["counts"]["gnss"]["used"] > 0


def test_a_recording_in_which_nothing_starts_says_why(drive):
    with pytest.raises(holdfast.EstimatorError, match="never started"):
        holdfast.replay(*drive, duration_s=0.5)


def test_the_package_of_that_name_is_still_one():
    from holdfast.replay.runner import Replay

    assert holdfast.replay.runner.Replay is Replay and callable(holdfast.replay)


def test_importing_holdfast_imports_nothing_heavy():
    code = "import sys, holdfast; print({'numpy', 'gtsam', 'pydantic', 'numba'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_simulation_can_be_smoothed_and_judged_by_its_truth(tmp_path):
    pytest.importorskip("trimesh")
    simulated = holdfast.simulate("quick", tmp_path / "quick", seed=1, duration_s=20.0)
    result = holdfast.smooth(simulated.recording, simulated.config)
    assert result.smoothed is not None
    errors = result.smoothed.errors(simulated.truth)
    assert errors.statistics()["horizontal_m"].rms < 0.03
    notes = tmp_path / "mine" / "notes.txt"
    notes.parent.mkdir()
    notes.touch()
    for output, words in (
        (notes.parent, "holds what Holdfast did not write"),
        (notes, "is a file: the output must be a folder"),
        (notes / "out", "cannot be written"),
    ):
        with pytest.raises(holdfast.ConfigError, match=words):
            holdfast.simulate("quick", output, duration_s=2.0)
    with pytest.raises(holdfast.ConfigError, match="duration_s: must be > 1"):
        holdfast.simulate("quick", tmp_path / "quick", duration_s=0.1)


@pytest.mark.slow
def test_the_example_passes_mypy_strict_outside_of_the_repository(tmp_path):
    copy = tmp_path / "api_example.py"
    copy.write_text(EXAMPLE.read_text())
    command = [sys.executable, "-m", "mypy", "--strict", copy.name]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_the_example_runs():
    done = subprocess.run([sys.executable, EXAMPLE, "30"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "batch  against" in done.stdout


def test_a_folder_of_an_earlier_run_is_replaced_and_one_of_somebody_else_refused(drive, tmp_path):
    out = tmp_path / "out"
    holdfast.replay(*drive, output=out, duration_s=8.0)
    (out / "notes.txt").write_text("of somebody else\n")
    with pytest.raises(holdfast.ConfigError, match=r"notes\.txt"):
        holdfast.replay(*drive, output=out, duration_s=8.0)
    (out / "notes.txt").unlink()
    holdfast.smooth(*drive, output=out, duration_s=8.0)
    assert (out / "causal").is_dir() and not (out / "estimates.mcap").exists()


def test_what_was_learnt_is_kept_in_a_file(drive, tmp_path):
    learnt = tmp_path / "learnt.json"
    first = holdfast.replay(*drive, learnt=learnt)
    kept = learnt.read_text()
    rows = first.summary["learnt"]
    assert any(row["key"] == "sensors.lidar.time_offset_s" for row in rows)
    holdfast.replay(*drive, duration_s=5.0, learnt=learnt)
    assert learnt.read_text() != kept
    with pytest.raises(holdfast.ConfigError, match="learnt: must be a path, not int"):
        holdfast.replay(*drive, learnt=3)


def test_a_sensor_that_the_recording_lacks_is_named_and_strictly_refused(drive):
    from ruamel.yaml import YAML

    data = YAML(typ="safe").load(Path(drive[1]).read_text())
    data["sensors"]["wheels"] = {"kind": "twist", "topic": "/wheels", "frame": "imu"}
    result = holdfast.replay(drive[0], data, duration_s=8.0)
    assert "/wheels" in result.summary["missing"]["wheels"]
    with pytest.raises(holdfast.RecordingError, match="/wheels"):
        holdfast.replay(drive[0], data, duration_s=8.0, strict=True)


def made(config, *args, **options):
    return holdfast.Estimator(holdfast.load_config(config), *args, **options)


@pytest.mark.parametrize(("call", "words"), [
    (lambda _, config: holdfast.replay(None, config), "recording: must be a path, not NoneType"),
    (lambda bag, config: holdfast.replay(bag, config, output=[]), "output: must be a path, not list"),
    (lambda bag, config: holdfast.replay(bag, config, start_s="1"), "start_s: must be a number .s. >= 0, got '1'"),
    (lambda bag, config: holdfast.smooth(bag, config, duration_s=True), "duration_s: must be a number .s. >= 0, got T"),
    (lambda _, config: holdfast.calibrate(None, config), "recordings: must be a path or several, not NoneType"),
    (lambda bag, config: holdfast.calibrate([bag, 3], config), "recordings: must be a path, not int"),
    (lambda bag, config: holdfast.calibrate(bag, config, hold_out="2"), "hold_out: must be an integer >= 2, got '2'"),
    (lambda *_: holdfast.simulate(3, "out"), "scenario: must be a path, not int"),
    (lambda *_: holdfast.simulate("quick", None), "output: must be a path, not NoneType"),
    (lambda *_: holdfast.simulate("quick", "out", seed=1.5), "seed: must be an integer >= 0, got 1.5"),
    (lambda *_: holdfast.simulate("quick", "out", seed=-1), "seed: must be an integer >= 0, got -1"),
    (lambda *_: holdfast.simulate("quick", "out", duration_s="9"), "duration_s: must be > 1 and <= 36000 .s., got '9'"),
    (lambda _, config: holdfast.Estimator(config), "config: must be a Config, as load_config gives, not .*Path"),
    (lambda *_: holdfast.RealtimeEstimator(None), "config: must be a Config, as load_config gives, not NoneType"),
    (lambda _, config: made(config, 3), "listener: must have the methods of a Listener, not be a int"),
    (lambda _, config: made(config, learnt="l.json"), "learnt: must be what `learnt..` of an estimator returns, not s"),
    (lambda _, config: made(config, learnt=None).stamp("x"), "time_ns: must be a whole number of nanoseconds .* 'x'"),
    (lambda bag, config: holdfast.replay(bag, config, hold_out={"imu": 2}), r"hold_out\['imu'\]: imu gives no positi"),
    (lambda bag, config: holdfast.replay(bag, config, hold_out="gnss=2"), "hold_out: must be a dict by sensor"),
    (lambda bag, config: holdfast.replay(bag, config, outage={"gnss": 5}), "outage.*must be .start, end. .s., got 5"),
    (lambda bag, config: holdfast.smooth(bag, config, window_s=float("nan")), "window_s nan: must be from 10 to"),
    (lambda bag, config: holdfast.smooth(bag, config, overlap_s="x"), "overlap_s 'x' .str.: must be from 5 to"),
    (lambda bag, config: holdfast.replay(bag, config, strict="x"), "strict: must be True or False, got 'x'"),
    (lambda bag, config: holdfast.replay(bag, config, progress=1), "progress: must be True or False, got 1"),
    (lambda bag, config: holdfast.smooth(bag, config, strict=None), "strict: must be True or False, got None"),
    (lambda bag, config: holdfast.calibrate(bag, config, lever_arms="no"), "lever_arms: must be True or False, got 'n"),
    (lambda bag, config: holdfast.calibrate(bag, config, progress="x"), "progress: must be True or False, got 'x'"),
    (lambda bag, config: holdfast.calibrate([bag, bag], config), "bag: is given twice, and would count twice"),
    (lambda _, config: holdfast.replay("", config), "recording: must be a path, got an empty text"),
    (lambda bag, config: holdfast.replay(bag, config, output=""), "output: must be a path, got an empty text"),
    (lambda bag, _: holdfast.replay(bag, ""), "config: must be a path, got an empty text"),
    (lambda bag, config: holdfast.replay(bag, config, start_s=10**400), "start_s: must be a number .s. >= 0, got a n"),
    (lambda bag, config: holdfast.replay(bag, config, start_s=-1.0), "start_s: must be a number .s. >= 0, got -1.0"),
    (lambda bag, config: holdfast.replay(bag, config, hold_out=[]), "hold_out: must be a dict by sensor, not list"),
    (lambda bag, config: holdfast.replay(bag, config, outage={"gnss": ("1", "2")}), "outage.*got a tuple of 2: .'1'"),
    (lambda bag, config: holdfast.replay(bag, config, outage={"gnss": {2, 1}}), "outage.*must be .start, end. .s."),
    (lambda bag, config: holdfast.replay(bag, config, outage={"gnss": (1, 10**400)}), "outage.*must be .start, end. "),
    (lambda bag, config: holdfast.smooth(bag, config, window_s=10**400), "window_s a number of more than 64 bits: "),
    (lambda *_: holdfast.load_config(None), "the file of a configuration: must be a path, not NoneType"),
    (lambda _, config: holdfast.Estimator(holdfast.load_config(config)).process(3), "message: must be one of"),
])  # fmt: skip
def test_an_argument_of_another_type_is_named(drive, call, words):
    with pytest.raises(holdfast.HoldfastError, match=words):
        call(*drive)


def test_a_result_is_shown_on_a_few_lines(smoothed):
    assert len(repr(smoothed).splitlines()) < 10
    assert f"world: {smoothed.world!r}" in repr(smoothed)
