import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from holdfast.cli import main
from holdfast.recording.tum import write_tum
from holdfast.state import Trajectory


def circle(radius_m=20.0, count=600):
    angle = np.linspace(0.0, 4.0, count)
    positions = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.sin(angle)], axis=1)
    half_yaw = (angle + np.pi / 2) / 2
    quaternions = np.stack([0 * angle, 0 * angle, np.sin(half_yaw), np.cos(half_yaw)], axis=1)
    return Trajectory(np.arange(count) * 100_000_000 + 1_694_161_404_000_000_000, positions, quaternions)


@pytest.fixture
def tracks(tmp_path):
    reference = circle()
    write_tum(tmp_path / "reference.tum", reference)
    write_tum(tmp_path / "estimate.tum", replace(reference, positions=reference.positions + np.array([0.3, -0.4, 0.0])))
    return tmp_path


@pytest.fixture
def holdfast(monkeypatch, capsys, tracks):
    """Run `holdfast evaluate` in the folder of the tracks; return exit code, output and errors."""
    monkeypatch.chdir(tracks)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["holdfast", "evaluate", *arguments])
        code = 0
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        output = capsys.readouterr()
        return code, output.out, output.err

    return run


def row(output, name):
    return next(line.split() for line in output.splitlines() if line.startswith(name))


def test_the_table_tells_the_error(holdfast):
    code, output, errors = holdfast("estimate.tum", "reference.tum")
    assert (code, errors) == (0, "")
    assert row(output, "translation [m]")[2:] == ["0.5000", "0.0000", "0.5000", "0.5000", "0.5000", "0.5000", "600"]
    assert row(output, "east [m]")[2] == "0.3000"
    assert row(output, "north [m]")[2] == "-0.4000"


def test_a_pipe_gets_plain_text(holdfast):
    _, output, _ = holdfast("estimate.tum", "reference.tum", "--interval", "a [b]=1:20")
    assert output.isascii() and "\x1b" not in output and "…" not in output
    assert "a [b]" in output


@pytest.mark.parametrize("alignment", ["yaw", "se3"])
def test_alignment_removes_a_shift(holdfast, alignment):
    _, output, _ = holdfast("estimate.tum", "reference.tum", "--align", alignment)
    assert row(output, "translation [m]")[4] == "0.0000"


def test_json_holds_every_alignment_interval_and_delta(holdfast, tracks):
    arguments = ["--align", "all", "--interval", "outage=10:20", "--kitti", "--json", "out.json"]
    code, _, _ = holdfast(
        "estimate.tum", "reference.tum", *arguments, "--rpe-distance", "5", "--rpe-distance", "20", "--rpe-time", "2"
    )
    content = json.loads((tracks / "out.json").read_text())
    assert code == 0
    assert list(content["alignments"]) == ["none", "yaw", "se3"]
    score = content["alignments"]["none"]["scores"]["outage"]
    assert list(score["rpe"]) == ["5 m", "20 m", "2 s", "KITTI"]
    assert score["end"]["horizontal_m"] == pytest.approx(0.5)
    assert content["alignments"]["se3"]["scores"]["all"]["ape"]["translation_m"]["max"] < 1e-8
    assert content["alignments"]["yaw"]["transform"]["translation_m"] == pytest.approx([-0.3, 0.4, 0.0], abs=1e-7)


@pytest.mark.parametrize(
    ("name", "text"), [("intervals.yaml", "tunnel: [10, 20]\nyard: [30, 40]\n"), ("i.json", '{"tunnel": [10, 20.5]}')]
)
def test_intervals_come_from_a_file_too(holdfast, tracks, name, text):
    (tracks / name).write_text(text)
    code, output, _ = holdfast("estimate.tum", "reference.tum", "--intervals", name, "--interval", "gate=1:2")
    assert code == 0 and row(output, "tunnel") and row(output, "gate")


def test_the_plot_is_written(holdfast, tracks):
    code, _, _ = holdfast("estimate.tum", "reference.tum", "--plot", "figure.png", "--interval", "outage=10:20")
    assert code == 0 and (tracks / "figure.png").stat().st_size > 20_000


def test_a_plot_in_a_folder_that_is_not_there_is_refused_before_the_table(holdfast):
    code, output, errors = holdfast("estimate.tum", "reference.tum", "--plot", "none/figure.png")
    assert code == 2 and not output and "none/figure.png: cannot be written (its folder does not exist)" in errors


def test_a_reference_without_orientation_is_reported_to_have_none(holdfast):
    _, output, _ = holdfast("estimate.tum", "reference.tum", "--position-only", "--reference-lever-arm", "0", "0", "1")
    assert "positions only" in output and "rotation" not in output
    assert row(output, "up [m]")[2] == "1.0000"


def test_an_offset_shifts_the_reference(holdfast):
    _, output, _ = holdfast("reference.tum", "reference.tum", "--reference-offset-s", "-1.0")
    assert float(row(output, "translation [m]")[2]) == pytest.approx(20.0 * 4.0 / 59.9, rel=0.01)


def test_an_alignment_that_the_tracks_do_not_determine_is_left_out_of_all_with_a_note(holdfast, tracks):
    straight = replace(circle(), positions=np.arange(600.0)[:, None] * np.array([1.0, 2.0, 0.5]))
    write_tum(tracks / "straight.tum", straight)
    code, output, errors = holdfast("straight.tum", "straight.tum", "--align", "all")
    assert code == 0 and "alignment yaw" in output and "alignment se3" not in output
    assert errors.startswith("note: ") and errors.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["estimate.tum", "absent.tum"], 3, "absent.tum"),
        (["later.tum", "reference.tum"], 3, "no overlap in time"),
        (["single.tum", "reference.tum"], 3, "at least 2"),
        (["backward.tum", "reference.tum"], 3, "backward.tum"),
        (["estimate.tum", "reference.tum", "--interval", "a=1"], 2, "NAME=START:END"),
        (["estimate.tum", "reference.tum", "--interval", "a=2:1"], 2, "before"),
        (["estimate.tum", "reference.tum", "--interval", "a=900:901"], 2, "holds no pose"),
        (["estimate.tum", "reference.tum", "--intervals", "absent.yaml"], 2, "absent.yaml"),
        (["estimate.tum", "reference.tum", "--intervals", "reference.tum"], 2, "name: [start, end]"),
        (["estimate.tum", "reference.tum", "--rpe-distance", "0"], 2, "--rpe-distance 0: must be > 0"),
        (["estimate.tum", "reference.tum", "--max-gap-s", "nan"], 2, "finite"),
        (
            ["estimate.tum", "reference.tum", "--max-difference-s", "5"],
            2,
            "--max-difference-s: is for --association near",
        ),
        (
            ["estimate.tum", "reference.tum", "--max-gap-s", "5", "--association", "nearest"],
            2,
            "--max-gap-s: is for --association interpolate, not nearest",
        ),
        (["estimate.tum", "reference.tum", "--plot", "figure.gif"], 2, ".png"),
        (["estimate.tum", "reference.tum", "--json", "nowhere/out.json"], 2, "nowhere"),
    ],
)
def test_a_mistake_ends_in_one_line_and_its_exit_code(holdfast, tracks, arguments, code, words):
    reference = circle()
    write_tum(tracks / "later.tum", replace(reference, stamps_ns=reference.stamps_ns + 10**12))
    (tracks / "single.tum").write_text("1694161404.5 0 0 0 0 0 0 1\n")
    (tracks / "backward.tum").write_text("2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")
    ended, _, errors = holdfast(*arguments)
    assert ended == code
    assert words in errors and errors.startswith("error: ") and errors.count("\n") == 1


@pytest.fixture
def second(tracks):
    """Another system: twice as far off, and silent in the last quarter."""
    reference = circle()
    positions = reference.positions + np.array([0.6, -0.8, 0.0])
    write_tum(
        tracks / "second.tum", Trajectory(reference.stamps_ns[:450], positions[:450], reference.quaternions[:450])
    )


def test_several_systems_stand_side_by_side(holdfast, second):
    code, output, errors = holdfast("estimate.tum", "second.tum", "reference.tum", "--interval", "curve=5:10")
    assert (code, errors) == (0, "")
    assert "compared   450 poses that all have" in output
    lines = [line.split() for line in output.splitlines()]
    absolute, relative, interval = (
        [of for of in lines if of[:1] == [name]] for name in ("estimate.tum", "second.tum", "Interval")
    )
    assert absolute[0][1:4] == ["600", "0.5000", "0.5000"]
    assert relative[0][1:4] == ["450", "1.0000", "1.0000"]
    assert interval == [["Interval", "curve,", "5.0", "to", "9.9", "s"]]
    assert "\x1b" not in output


def test_segments_longer_than_the_track_are_named_with_several_systems_too(holdfast, second):
    command = ("estimate.tum", "second.tum", "reference.tum", "--kitti", "--rpe-distance", "5", "--rpe-distance", "9e6")
    code, output, _ = holdfast(*command)
    assert code == 0
    assert "over 9e+06 m: the track is too short" in output
    assert "KITTI, 100 to 800 m" in output


def test_several_systems_are_written_and_drawn(holdfast, tracks, second):
    pytest.importorskip("matplotlib")
    code, *_ = holdfast("estimate.tum", "second.tum", "reference.tum", "--json", "out.json", "--plot", "out.png")
    assert code == 0
    content = json.loads((tracks / "out.json").read_text())
    assert list(content["systems"]) == ["estimate.tum", "second.tum"]
    assert content["systems"]["second.tum"]["own_pairs"] == 450
    assert content["systems"]["second.tum"]["scores"]["all"]["ape"]["horizontal_m"]["rms"] == pytest.approx(1.0)
    assert len(content["systems"]["estimate.tum"]["segments_translation_m"]) == 5
    assert (tracks / "out.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["estimate.tum"], 2, "Missing argument 'REFERENCE'"),
        (["estimate.tum", "estimate.tum", "reference.tum"], 2, "estimate.tum: is given twice"),
        (["estimate.tum", "x/../estimate.tum", "reference.tum"], 2, "estimate.tum: is given twice"),
        (
            ["estimate.tum", "reference.tum", "--json", "x.png", "--plot", "x.png"],
            2,
            "--plot x.png: is given twice (--json and --plot)",
        ),
        (["estimate.tum", "second.tum", "reference.tum", "--align", "all"], 2, "choose none, yaw or se3"),
        (["estimate.tum", "absent.tum", "reference.tum"], 3, "absent.tum"),
    ],
)
def test_a_mistake_with_several_ends_in_one_line(holdfast, second, arguments, code, words):
    ended, output, errors = holdfast(*arguments)
    assert (ended, output) == (code, "")
    assert words in errors.splitlines()[-1]


def test_help_imports_nothing_heavy():
    program = (
        "import sys\nfrom holdfast.cli import holdfast\n"
        "holdfast(['evaluate', '--help'], standalone_mode=False)\n"
        "print({'numpy', 'matplotlib', 'gtsam', 'rich', 'scipy'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_the_judge_imports_neither_the_judged_nor_evo_nor_scipy():
    program = (
        "import sys\nimport holdfast.evaluation.accuracy, holdfast.evaluation.consistency, holdfast.evaluation.plot\n"
        "judged = {'holdfast.sensors', 'holdfast.graph', 'holdfast.estimator'}\n"
        "print((judged | {'gtsam', 'evo', 'scipy', 'matplotlib'}) & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("several", [[], ["estimate.tum"]])
def test_quaternions_in_the_order_w_x_y_z_are_told(holdfast, tracks, several):
    """They were judged as they were read: errors of attitude of 100 deg, without a word."""
    track = circle()
    write_tum(tracks / "wxyz.tum", replace(track, quaternions=np.roll(track.quaternions, 1, axis=1)))
    code, output, errors = holdfast("wxyz.tum", *several, "reference.tum")
    assert code == 0 and "wxyz" in output
    assert errors.startswith("warning: wxyz.tum or reference.tum: the quaternions look like w x y z (a TUM file has x ")
