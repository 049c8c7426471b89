"""`holdfast map`: from scans and a trajectory to files, judged by the site that they show; mistakes in one line."""

import json
import shutil
from itertools import islice
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from holdfast.cli import holdfast
from holdfast.config.load import load_config
from holdfast.errors import HoldfastError, RecordingError
from holdfast.geometry.earth import Geodetic
from holdfast.mapping.source import Scans
from holdfast.output_folder import MARK, replaced
from holdfast.recording.tum import read_tum, write_tum
from holdfast.replay.reference import in_other_world
from holdfast.state import Trajectory

for package in ("embreex", "laspy", "lazrs", "pyproj", "matplotlib", "rerun"):
    pytest.importorskip(package)


def call(*arguments: str | Path) -> str:
    result = CliRunner().invoke(
        holdfast, [str(one) for one in arguments], catch_exceptions=False, standalone_mode=False
    )
    assert result.exit_code == 0
    return result.output


def run_of(folder: Path, poses: Trajectory, simulated: Path, **changes) -> Path:
    """Write what a map reads of a replay."""
    folder.mkdir()
    config = load_config(simulated / "config.yaml")
    summary = {"recording": "recording.mcap", "datum": config.frames.datum.model_dump()}
    summary |= {key: {} for key in ("counts", "timing", "held_out", "versions")}
    summary |= {"config": config.model_dump(mode="json")} | changes
    (folder / "summary.json").write_text(json.dumps(summary))
    write_tum(folder / "imu_in_world.tum", poses)
    return folder


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("quick")
    call("simulate", "quick", "-o", folder, "--scans", "--duration", "6")
    return folder


@pytest.fixture(scope="module")
def truth(simulated: Path) -> Trajectory:
    return read_tum(simulated / "truth" / "imu_in_world.tum")


@pytest.fixture(scope="module")
def out(simulated: Path, truth: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_of(tmp_path_factory.mktemp("made") / "out", truth, simulated)


def within_5_cm(folder: Path) -> float:
    found: float = json.loads((folder / "map.json").read_text())["site"]["regions"]["all"]["fraction_within"]
    return found


def test_true_poses_give_a_map_on_the_site_and_every_file(out: Path, simulated: Path):
    told = call("map", out, simulated / "recording.mcap", "--max-range", "20")
    # the ranges have a sigma of 2 cm: of points seen face on 98.8 % are within 5 cm, of the ground, aslant, nearly all
    assert within_5_cm(out) > 0.985
    assert "within 5 cm of site.ply" in told
    numbers = json.loads((out / "map.json").read_text())
    assert numbers["crs"] == "EPSG:32632"
    assert numbers["scans"] > 20
    assert all((out / f"map.{suffix}").stat().st_size > 10_000 for suffix in ("laz", "ply", "png", "rrd"))
    assert not list(out.glob("holdfast-map-*"))  # what was on disk meanwhile is gone


def test_a_map_from_poses_that_are_10_cm_off_is_found_off(tmp_path: Path, simulated: Path, truth: Trajectory):
    wrong = Trajectory(truth.stamps_ns, truth.positions + np.array([0.0, 0.0, 0.1]), truth.quaternions)
    folder = run_of(tmp_path / "wrong", wrong, simulated)
    call("map", folder, simulated / "recording.mcap", "--max-range", "15", "--voxel", "0.3", "-o", folder / "map.ply")
    assert within_5_cm(folder) < 0.2


QUICK = ("--max-range", "15", "--voxel", "0.3")


def test_a_run_about_another_datum_is_compared_in_its_own_world(tmp_path: Path, simulated: Path, truth: Trajectory):
    """Without `frames.datum` the datum is at the first fix: the map was compared with a site 3 m below it."""
    datum = load_config(simulated / "config.yaml").frames.datum
    here = Geodetic(**datum.model_dump())
    there = here._replace(latitude_deg=here.latitude_deg + 0.01, altitude_m=here.altitude_m + 3.0)  # 1.1 km
    moved = in_other_world(truth, here, there)
    folder = run_of(tmp_path / "out", moved, simulated, datum=there._asdict())
    told = call("map", folder, simulated / "recording.mcap", *QUICK, "-o", folder / "map.ply")
    assert within_5_cm(folder) > 0.9
    assert "site.ply is 1.11e+03 m from that of the run: it is judged by in the world of the run" in told


@pytest.mark.parametrize("whose", ["run", "site"])
def test_where_a_datum_is_not_known_it_is_told(tmp_path: Path, simulated: Path, truth: Trajectory, whose):
    folder, site = run_of(tmp_path / "out", truth, simulated), simulated / "site.ply"
    if whose == "run":
        folder = run_of(tmp_path / "nowhere", truth, simulated, datum=None)
    else:
        site = Path(shutil.copy(site, tmp_path))
    told = call("map", folder, simulated / "recording.mcap", *QUICK, "-o", folder / "map.ply", "--site", site)
    (line,) = (line for line in told.splitlines() if line.startswith("note: The datum of"))
    assert line.endswith("is not known: site.ply may be in another world than the run.")


def test_a_recording_that_is_cut_off_gives_the_map_until_the_cut(tmp_path: Path, out: Path, simulated: Path):
    data = (simulated / "recording.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    told = call("map", out, tmp_path / "cut.mcap", "-o", tmp_path / "map.ply")
    assert "is cut off or was never closed" in told
    assert (tmp_path / "map.ply").stat().st_size > 100_000


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), RecordingError("block 7 is damaged")])
def test_what_was_read_before_a_failure_is_written(tmp_path: Path, out: Path, simulated: Path, monkeypatch, failure):
    whole = Scans.read

    def read(self, progress=None):
        yield from islice(whole(self, progress), 8)
        raise failure

    monkeypatch.setattr(Scans, "read", read)
    with pytest.raises((click.Abort, type(failure))):
        call("map", out, simulated / "recording.mcap", "-o", tmp_path / "map.ply", "--max-range", "15")
    assert json.loads((out / "map.json").read_text())["scans"] == 8
    assert (tmp_path / "map.ply").stat().st_size > 100_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-o", "map.pcd"], r"-o map.pcd: unknown kind of file \(allowed: .las, .laz"),
        (["-o", "none/map.ply"], "its folder does not exist"),
        (["--voxel", "0"], "--voxel 0: must be from 0.01 to 10 m"),
        (["--max-range", "nan"], "--max-range nan: must be from 1 to 1000 m"),
        (["--keep-above", "2"], "--keep-above 2: must be from 0 to 1"),
        (["--colour", "intensity"], r"--colour intensity: /lidar/points has no field for it \(allowed: height, sigma"),
        (["--colour", "sigma"], "--colour sigma: .* holds no covariances"),
        (["--frame", "roof"], "no transforms lead from 'imu' to 'roof' .*: give another with --frame"),
        (["--topic", "/imu/data"], r"'/imu/data' is sensor_msgs/msg/Imu \(allowed: sensor_msgs/msg/PointCloud2\)"),
        (["--crs", "EPSG:2100"], "--crs EPSG:2100: is for Greece"),
        (["--crs", "EPSG:4326"], "a map takes metres"),
        (["--site", "none.ply"], "--site none.ply: no such file"),
        (["--crs", "EPSG:2056", "-o", "map.ply"], "--crs EPSG:2056: is for LAS and LAZ, and none is written"),
        (["--geoid", "geoid.gtx", "-o", "map.png"], "--geoid geoid.gtx: is for LAS and LAZ, and none is written"),
    ],
)
def test_a_mistake_is_told_in_one_line(out: Path, simulated: Path, arguments, words):
    with pytest.raises(HoldfastError, match=words) as caught:
        call("map", out, simulated / "recording.mcap", *arguments)
    assert "\n" not in str(caught.value)


def test_a_site_that_is_none_is_told_before_scans_are_read(tmp_path: Path, out: Path, simulated: Path):
    with pytest.raises(HoldfastError, match="is no mesh with regions"):
        call("map", out, simulated / "recording.mcap", "--site", simulated / "config.yaml", "-o", tmp_path / "map.ply")
    assert not (tmp_path / "map.ply").exists()


@pytest.mark.parametrize("name", ["site.ply", "recording.mcap"])
def test_no_map_is_written_over_what_is_read(tmp_path: Path, out: Path, simulated: Path, name):
    """`-o site.ply` replaced the true surface, by which the map was then judged."""
    for file in ("site.ply", "recording.mcap"):
        shutil.copy(simulated / file, tmp_path)
    (tmp_path / "link.ply").symlink_to(tmp_path / name)
    with pytest.raises(HoldfastError, match=f"{name}, which is read: give another output"):
        call("map", out, tmp_path / "recording.mcap", "-o", tmp_path / "link.ply")
    assert (tmp_path / name).read_bytes() == (simulated / name).read_bytes()


def test_a_map_in_a_folder_of_results_is_replaced_with_it(tmp_path: Path, simulated: Path, truth: Trajectory):
    """Replays refused the folder: it held what Holdfast had not written."""
    folder = run_of(tmp_path / "out", truth, simulated)
    (folder / MARK).write_text(json.dumps({"command": "replay", "files": [one.name for one in folder.iterdir()]}))
    call("map", folder, simulated / "recording.mcap", "--max-range", "15", "--voxel", "0.5")
    with replaced(folder, "replay"):
        pass
    assert [one.name for one in folder.iterdir()] == [MARK]


def test_a_folder_that_no_replay_wrote_is_told(tmp_path: Path, simulated: Path):
    with pytest.raises(HoldfastError, match="allowed: a folder that `holdfast replay` has written"):
        call("map", tmp_path, simulated / "recording.mcap")


def test_a_trajectory_of_another_day_is_told(tmp_path: Path, simulated: Path, truth: Trajectory):
    later = Trajectory(truth.stamps_ns + 86_400 * 10**9, truth.positions, truth.quaternions)
    folder = run_of(tmp_path / "later", later, simulated)
    with pytest.raises(HoldfastError, match=r"covers none of the \d+ scans.*is it of this recording\?"):
        call("map", folder, simulated / "recording.mcap")


def test_a_recording_without_clouds_is_told(tmp_path: Path, out: Path):
    call("simulate", "quick", "-o", tmp_path, "--duration", "2")
    with pytest.raises(HoldfastError, match="has no topic of sensor_msgs/msg/PointCloud2"):
        call("map", out, tmp_path / "recording.mcap")


def test_without_a_site_nothing_is_compared(tmp_path: Path, out: Path, simulated: Path):
    shutil.copy(simulated / "recording.mcap", tmp_path)
    told = call("map", out, tmp_path / "recording.mcap", "--max-range", "15", "-o", tmp_path / "map.ply")
    assert "within 5 cm" not in told
    assert "site" not in json.loads((out / "map.json").read_text())
