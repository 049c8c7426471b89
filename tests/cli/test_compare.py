"""`holdfast compare`: two replays, a table on the terminal and a page; mistakes end in one line."""

import json
import shutil
import sys
from pathlib import Path

import pytest

pytest.importorskip("plotly")
sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from small_drive import holdfast, make_rows, write_config, write_mcap

from holdfast.cli.names import names_of
from holdfast.output_folder import replaced


@pytest.fixture(scope="module")
def outs(tmp_path_factory):
    """The same drive with two windows, and with the antenna at another place."""
    folder = tmp_path_factory.mktemp("compare")
    bag = write_mcap(folder / "bag", make_rows(seconds=10.0))
    for name, changes in (("one", {}), ("two", {"gnss": {"gate_sigma": 6.0}, "lidar": None})):
        config = write_config(folder / f"{name}.yaml", **changes)
        done = holdfast("replay", bag, "-c", config, "-o", folder / name, "--hold-out", "gnss=2")
        assert done.code == 0, done.err
    return folder


def test_two_replays_are_compared_in_a_table_and_on_a_page(outs, tmp_path):
    done = holdfast("compare", outs / "one", outs / "two", "-o", tmp_path / "page.html")
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert "the trajectories are" in lines[0]
    assert any(line.split() == ["sensors.gnss.gate_sigma", "4", "6"] for line in lines)
    assert any(line.strip().startswith("held out, causal, all: horizontal RMS [m]") for line in lines)
    assert lines[-1] == f"written to {tmp_path / 'page.html'} and page.json"
    numbers = json.loads((tmp_path / "page.json").read_text())
    assert set(numbers["figures"]) == {"tracks", "apart-over-time", "health"}
    assert [row[0] for row in numbers["tables"]["counts"]["rows"] if row[0].endswith("lidar: used")] == ["lidar: used"]


def test_the_page_lies_in_the_second_folder_by_default(outs, tmp_path):
    for name in ("one", "two"):
        shutil.copytree(outs / name, tmp_path / name)
    assert holdfast("compare", tmp_path / "one", tmp_path / "two").code == 0
    assert (tmp_path / "two" / "compare.html").exists()
    with replaced(tmp_path / "two", "replay"):  # it is Holdfast's, and goes with the folder
        pass


def test_replays_with_other_datums_are_compared_in_one_world_frame(outs, tmp_path):
    """The same estimate about another origin was told to be metres away."""
    bag = outs / "bag"
    config = write_config(tmp_path / "free.yaml", datum=False)
    assert holdfast("replay", bag, "-c", config, "-o", tmp_path / "free", "--hold-out", "gnss=2").code == 0
    judge = ("--reference", outs / "one" / "smoothed_in_world.tum", "-o", tmp_path / "page.html")
    done = holdfast("compare", tmp_path / "free", outs / "one", *judge)
    assert done.code == 0
    assert "The datums differ: free is shown, and judged, in the world frame of one." in done.out
    tables = json.loads((tmp_path / "page.json").read_text())["tables"]
    apart = {row[0]: row[1] for row in tables["apart"]["rows"]}
    assert apart["horizontal [m]"] < 0.02
    assert apart["vertical [m]"] < 0.02
    errors = {row[0]: row[1:3] for row in tables["accuracy"]["rows"]}
    assert max(errors["against the reference, horizontal RMS [m]"]) < 0.1


def test_a_reference_judges_both(outs, tmp_path):
    truth = outs / "one" / "smoothed_in_world.tum"
    done = holdfast("compare", outs / "one", outs / "two", "--reference", truth, "-o", tmp_path / "page.html")
    assert done.code == 0
    assert "against the reference, horizontal RMS [m]" in done.out


def test_what_smooth_wrote_is_judged_by_its_optimum(outs, tmp_path):
    """The errors were those of the causal run beside it, the distances those of the optimum."""
    assert holdfast("smooth", outs / "bag", "-c", outs / "one.yaml", "-o", tmp_path / "best").code == 0
    truth = tmp_path / "best" / "imu_in_world.tum"
    done = holdfast("compare", outs / "one", tmp_path / "best", "--reference", truth, "-o", tmp_path / "page.html")
    assert done.code == 0, done.err
    assert "best: the optimum over the recording is shown, and judged; health" in done.out
    tables = json.loads((tmp_path / "page.json").read_text())["tables"]
    (row,) = [row for row in tables["accuracy"]["rows"] if row[0] == "against the reference, horizontal RMS [m]"]
    assert row[1] > 1e-3 > row[2] == 0.0  # the optimum against itself


@pytest.mark.parametrize(
    ("first", "second", "code", "words"),
    [
        ("one", "one", 2, "are one folder"),
        ("one", "absent", 2, "summary.json: no such file or directory"),
        ("bag", "two", 2, "allowed: a folder that `holdfast replay` has written"),
    ],
)
def test_a_mistake_ends_in_one_line(outs, first, second, code, words):
    done = holdfast("compare", outs / first, outs / second)
    assert (done.code, done.out) == (code, "")
    assert len(done.err.splitlines()) == 1
    assert words in done.err


def test_names_are_as_short_as_they_can_be():
    assert names_of(Path("/x/a"), Path("/x/b")) == ("a", "b")
    assert names_of(Path("/x/a/o.tum"), Path("/x/b/o.tum")) == ("a/o.tum", "b/o.tum")
