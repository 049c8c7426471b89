"""Trajectories in the TUM format."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.errors import RecordingError
from holdfast.recording.tum import TumWriter, read_tum, write_tum
from holdfast.state import Trajectory

ROW = "1.5 1 2 3 0 0 0 1\n"


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@given(
    stamps=st.lists(st.integers(-(10**9), 2**62), min_size=1, max_size=30, unique=True),
    values=st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
    quaternion=st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
)
def test_what_is_written_is_read_back_stamps_exactly(tmp_path_factory, stamps, values, quaternion) -> None:
    stamps.sort()
    q = np.array(quaternion) / np.linalg.norm(quaternion)
    n = len(stamps)
    path = tmp_path_factory.mktemp("tum") / "t.tum"
    write_tum(path, Trajectory(np.array(stamps, dtype=np.int64), np.tile(values, (n, 1)), np.tile(q, (n, 1))))
    back = read_tum(path)
    assert back.stamps_ns.tolist() == stamps
    np.testing.assert_allclose(back.positions, np.tile(values, (n, 1)), atol=6e-10)
    np.testing.assert_allclose(back.quaternions, np.tile(q, (n, 1)), atol=2e-9)


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1317600534.598375681", 1317600534598375681),
        ("1317600534.598375680999", 1317600534598375681),
        ("1.317600534598375681e+09", 1317600534598375681),
        ("0", 0),
        ("-0.5", -500_000_000),
    ],
)
def test_stamps_never_pass_through_float64(tmp_path: Path, text: str, stamp_ns: int) -> None:
    trajectory = read_tum(write(tmp_path / "t.tum", f"# t x y z qx qy qz qw\n\n{text} 1 2 3 0 0 0 1\n"))
    assert trajectory.stamps_ns.tolist() == [stamp_ns]


def test_a_row_has_nine_decimals(tmp_path: Path) -> None:
    with TumWriter(tmp_path / "t.tum") as writer:
        writer.extend([1317600534598375681], np.array([1.0, -2.0, 1 / 3]), [0.0, 0.0, 0.6, 0.8])
    assert (tmp_path / "t.tum").read_text() == (
        "1317600534.598375681 1.000000000 -2.000000000 0.333333333 0.000000000 0.000000000 0.600000000 0.800000000\n"
    )


def test_a_killed_run_keeps_every_block_and_no_half_row(tmp_path: Path) -> None:
    writer = TumWriter(tmp_path / "t.tum")
    for begin in range(0, 1000, 50):
        stamps = range(begin, begin + 50)
        writer.extend(stamps, np.full((50, 3), -1e6), np.tile([0.0, 0.0, 0.0, 1.0], (50, 1)))
    text = (tmp_path / "t.tum").read_text()  # before close: this is what a kill leaves
    writer.close()
    assert [line.split()[0] for line in text.splitlines()] == [f"0.{k:09d}" for k in range(1000)]
    assert text.endswith("\n")
    assert all(len(line.split()) == 8 for line in text.splitlines())


def test_quaternions_of_few_digits_are_normalised(tmp_path: Path) -> None:
    trajectory = read_tum(write(tmp_path / "t.tum", "1 0 0 0 0 0 0.7071 0.7071\n"))
    np.testing.assert_allclose(np.linalg.norm(trajectory.quaternions, axis=1), 1, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (ROW + "2.5 1 2 3\n", "t.tum:2: has 4 columns (allowed: 8, t x y z qx qy qz qw)"),
        ("2.5,1,2,3,0,0,0,1\n", "t.tum:1: has 1 column (allowed: 8 with spaces between them, t x y z qx qy qz qw)"),
        (ROW + "2.5 1 2 x 0 0 0 1\n", "t.tum:2: is not made of 8 numbers"),
        (ROW + "now 1 2 3 0 0 0 1\n", "t.tum:2: is not made of 8 numbers"),
        (ROW + "2.5 1_0 2 3 0 0 0 1\n", "t.tum:2: is not made of 8 numbers"),
        (ROW + "inf 1 2 3 0 0 0 1\n", "t.tum:2: has a number that is not finite or a stamp beyond 292 years"),
        (ROW + "1e999999 1 2 3 0 0 0 1\n", "t.tum:2: has a number that is not finite or a stamp beyond 292 years"),
        (ROW + "2.5 1 2 nan 0 0 0 1\n", "t.tum:2: has a number that is not finite"),
        (ROW + "1e30 1 2 3 0 0 0 1\n", "t.tum:2: has a number that is not finite or a stamp beyond 292 years"),
        (ROW + "1700000000000.5 1 2 3 0 0 0 1\n", "a stamp beyond 292 years (allowed: seconds)"),  # milliseconds
        (ROW + "2.5 1 2 3 0 0 0 0.5\n", "t.tum:2: quaternion has norm 0.5 (allowed: 1"),
        (ROW + "\n" + ROW, "t.tum:3: stamp 1.5 is not later than the one before it"),
        ("# nothing\n", "t.tum: holds no poses"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, text: str, error: str) -> None:
    with pytest.raises(RecordingError) as caught:
        read_tum(write(tmp_path / "t.tum", text))
    assert error in str(caught.value)


def test_a_missing_file_is_an_error_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"t\.tum: no such file"):
        read_tum(tmp_path / "t.tum")
