"""Trajectories as arrays: interpolation, errors, frames of data, files, figures."""

import dataclasses

import numpy as np
import pytest

import holdfast
from holdfast.evaluation.states import from_rotation_vector


def turning(n=50, **more):
    """A circle at 1 rad/s and 2 m radius, 10 Hz."""
    t = np.arange(n) * 0.1
    positions = 2.0 * np.column_stack([np.sin(t), 1.0 - np.cos(t), 0.0 * t])
    q = from_rotation_vector(np.column_stack([0.0 * t, 0.0 * t, t]))
    velocities = 2.0 * np.column_stack([np.cos(t), np.sin(t), 0.0 * t])
    return holdfast.Trajectory((t * 1e9).round().astype(np.int64), positions, q, velocities, **more)


def test_interpolation_keeps_the_given_poses_and_turns_evenly_between_them():
    track = turning()
    assert np.allclose(track.interpolate(track.stamps_ns[3:9]).positions, track.positions[3:9])
    between = track.interpolate(np.array([1_250_000_000]))
    assert np.allclose(2.0 * np.arctan2(between.quaternions_xyzw[0, 2], between.quaternions_xyzw[0, 3]), 1.25)
    assert between.velocities.shape == (1, 3) and between.covariances is None


@pytest.mark.parametrize("stamps", [[-1], [10**12]])
def test_stamps_beyond_the_ends_cannot_be_interpolated(stamps):
    with pytest.raises(holdfast.MessageError, match=r"stamps_ns: must be within 0 and 4900000000 \[ns\]"):
        turning().interpolate(stamps)


@pytest.mark.parametrize("stamps", [[0.5], [[1, 2]], [5, 4], [7, 7], None, ["5"], [2**70]])
def test_stamps_that_are_none_get_one_error_wherever_they_are_given(stamps):
    """`interpolate` had another than the constructor, and for what is no array that of numpy."""
    with pytest.raises(holdfast.MessageError) as made:
        one_pose(stamps_ns=stamps)
    with pytest.raises(holdfast.MessageError) as interpolated:
        turning().interpolate(stamps)
    assert str(made.value) == str(interpolated.value)


def test_at_no_stamps_there_are_no_poses():
    assert len(turning().interpolate([])) == 0


def test_errors_are_those_of_the_estimate_minus_the_reference():
    track = turning()
    moved = holdfast.Trajectory(track.stamps_ns, track.positions + np.array([0.3, 0.4, 0.1]), track.quaternions_xyzw)
    errors = moved.errors(track)
    assert np.allclose(errors["horizontal_m"], 0.5) and np.allclose(errors["up_m"], 0.1)
    assert errors.statistics()["east_m"].rms == pytest.approx(0.3)
    assert moved.errors(track, alignment="se3")["translation_m"].max() < 1e-9


def test_sigmas_are_along_the_axes_of_the_world():
    body = np.tile(np.diag(np.square([1.0, 1.0, 1.0, 0.1, 0.2, 0.3, 1.0, 1.0, 1.0])), (50, 1, 1))
    track = turning(covariances=body)
    assert np.allclose(track.sigmas_m()[0], [0.1, 0.2, 0.3])
    quarter = int(np.argmin(abs(track.times_s - np.pi / 2)))
    assert np.allclose(track.sigmas_m()[quarter], [0.2, 0.1, 0.3], atol=0.01)
    with pytest.raises(holdfast.ConfigError, match="covariances"):
        turning().sigmas_m()


def test_a_data_frame_has_a_row_per_stamp():
    pandas = pytest.importorskip("pandas")
    frame = turning().to_dataframe("pandas")
    assert isinstance(frame, pandas.DataFrame) and len(frame) == 50
    assert list(frame.columns[:4]) == ["stamp_ns", "p_x_m", "p_y_m", "p_z_m"] and "v_z_m_s" in frame.columns


def test_a_library_that_is_not_installed_is_named(monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr("holdfast.api.trajectory.import_module", missing)
    with pytest.raises(holdfast.ConfigError, match="pip install polars"):
        turning().to_dataframe()


def test_a_trajectory_comes_back_from_its_files(tmp_path):
    covariances = np.tile(np.diag(np.arange(1.0, 10.0)), (50, 1, 1))
    turning(covariances=covariances).write(tmp_path / "track.tum")
    again = holdfast.Trajectory.read(tmp_path / "track.tum")
    assert np.allclose(again.positions, turning().positions, atol=1e-9)
    assert again.covariances is not None and np.allclose(again.covariances, covariances)


def test_covariances_of_an_earlier_trajectory_do_not_stay_beside_another(tmp_path):
    """They were read as those of the later one."""
    turning(covariances=np.tile(np.eye(9), (50, 1, 1))).write(tmp_path / "track.tum")
    turning().write(tmp_path / "track.tum")
    assert holdfast.Trajectory.read(tmp_path / "track.tum").covariances is None


@pytest.mark.parametrize(("call", "words"), [
    (lambda _: holdfast.Trajectory.read(None), "path: must be a path, not NoneType"),
    (lambda _: holdfast.Trajectory.read("a\0b"), "path: must be a path, which holds no NUL"),
    (lambda track: track.write(3), "path: must be a path, not int"),
    (lambda track: track.write("nodir/x"), r"nodir/x: cannot be written \(No such file or directory\)"),
    (lambda track: track.to_dataframe("json"), r"library: must be one of polars, pandas, got 'json' \(str\)"),
    (lambda track: track.to_dataframe(np.array(["polars", "pandas"])), "library: must be one of .*, got an array"),
    (lambda track: track.errors(track, max_gap_s="x"), r"max_gap_s: must be a number \[s\] >= 0, got 'x'"),
    (lambda track: track.errors(track, max_gap_s=10**400), r"max_gap_s: must be a number \[s\] >= 0, got a number of"),
    (lambda track: track.errors(track, alignment=np.array(["yaw", "se3"])), "alignment: must be one of none, yaw"),
    (lambda track: track.errors(track)[np.array(["up_m", "east_m"])], "errors.*: must be one of translation_m"),
    (lambda track: track.errors(track)["error"], "errors.'error'.: must be one of translation_m, horizontal_m"),
    (lambda track: track.errors(track)[["up_m"]], r"errors\[\['up_m'\]\]: must be one of translation_m"),
])  # fmt: skip
def test_an_argument_that_cannot_be_is_named(call, words, tmp_path, monkeypatch):
    """A TypeError of pathlib, an OSError, an AttributeError of whichever module had the name."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(holdfast.ConfigError, match=words):
        call(turning())


def test_a_figure_shows_track_and_errors():
    pytest.importorskip("matplotlib")
    assert len(turning().plot().axes) == 1
    assert len(turning().plot(turning()).axes) == 4


def test_a_trajectory_is_shown_on_one_line():
    assert repr(turning()) == "Trajectory(50 poses, 4.9 s, 9.8 m, velocities)"


@pytest.mark.parametrize("reference", ["truth.tum", 3, None])
def test_a_reference_that_is_no_trajectory_is_named(reference):
    with pytest.raises(holdfast.ConfigError, match="reference: must be a Trajectory"):
        turning().errors(reference)


@pytest.mark.parametrize("alignment", ["SE3", "sim3", "", None, True, ["yaw"]])
def test_an_alignment_that_there_is_not_is_named(alignment):
    """Whatever was neither `none` nor `yaw` was taken for `se3`."""
    with pytest.raises(holdfast.ConfigError, match="alignment: must be one of none, yaw, se3, got"):
        turning().errors(turning(), alignment=alignment)


def one_pose(**changes):
    arrays = {"stamps_ns": [5], "positions": [[1, 2, 3]], "quaternions_xyzw": [[0, 0, 0, 1]]}
    return holdfast.Trajectory(**arrays | changes)


def no_poses():
    return one_pose(stamps_ns=[], positions=np.zeros((0, 3)), quaternions_xyzw=np.zeros((0, 4)))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"stamps_ns": [0.5]}, r"stamps_ns: must be an array \(N,\) of whole numbers \[ns\], got a list of 1: \[0.5\]"),
        ({"stamps_ns": np.array([1.0])}, r"stamps_ns: must be .* got an array \(1,\) of float64"),
        ({"stamps_ns": np.zeros(0)}, r"stamps_ns: must be .* got an array \(0,\) of float64"),
        ({"stamps_ns": 5}, r"stamps_ns: must be .* got 5 \(int\)"),
        ({"stamps_ns": [True]}, "stamps_ns: must be .* whole numbers"),
        ({"stamps_ns": [2**63]}, "stamps_ns: must be .* whole numbers"),
        ({"stamps_ns": [2**70]}, "stamps_ns: must be .* whole numbers"),
        ({"stamps_ns": [[1], [2, 3]]}, "stamps_ns: must be .* whole numbers"),
        ({"stamps_ns": [7, 7]}, r"stamps_ns: must increase \[ns\], but 7 comes after 7"),
        ({"stamps_ns": np.array([7, 5], dtype=np.uint64)}, r"stamps_ns: must increase \[ns\], but 5 comes after 7"),
        ({"stamps_ns": [5, 6]}, r"positions: must be an array \(2, 3\) of numbers \[m\], got a list of 1"),
        ({"positions": np.zeros((3, 3))}, r"positions: must be an array \(1, 3\) .* got an array \(3, 3\) of float64"),
        ({"positions": [["1", "2", "3"]]}, r"positions: must be an array \(1, 3\) of numbers \[m\]"),
        ({"positions": None}, r"positions: must be an array \(1, 3\) of numbers \[m\]"),
        ({"quaternions_xyzw": [[0, 0, 0]]}, r"quaternions_xyzw: must be an array \(1, 4\) of numbers \[1\]"),
        ({"velocities": [1, 2, 3]}, r"velocities: must be an array \(1, 3\) of numbers \[m/s\]"),
        ({"covariances": np.eye(9)}, r"covariances: must be an array \(1, 9, 9\) of numbers \[rad, m, m/s squared\]"),
    ],
)
def test_an_array_of_another_shape_or_type_is_named(wrong, words):
    """Stamps in seconds were lost by `write`, and positions of another length were found by what came later."""
    with pytest.raises(holdfast.MessageError, match=words):
        one_pose(**wrong)


def test_lists_of_numbers_become_arrays(tmp_path):
    track = one_pose(stamps_ns=[5, 2**60 + 1], positions=[[1, 2, 3], [1, 2, 4]], quaternions_xyzw=[[0, 0, 0, 1]] * 2)
    assert track.stamps_ns.dtype == np.int64 and track.stamps_ns.tolist() == [5, 2**60 + 1]
    assert track.positions.dtype == track.quaternions_xyzw.dtype == np.float64
    track.write(tmp_path / "track.tum")
    again = holdfast.Trajectory.read(tmp_path / "track.tum")
    assert again.stamps_ns.tolist() == track.stamps_ns.tolist() and np.array_equal(again.positions, track.positions)
    assert repr(track) == "Trajectory(2 poses, 1152921504.6 s, 1.0 m)"


def test_one_pose_is_known_at_its_stamp_and_nowhere_else():
    """It was NaN."""
    track = one_pose(velocities=[[4, 5, 6]], covariances=np.eye(9)[None])
    found = track.interpolate([5])
    for name in ("stamps_ns", "positions", "quaternions_xyzw", "velocities", "covariances"):
        np.testing.assert_array_equal(getattr(found, name), getattr(track, name))
    for stamp_ns in (4, 6):
        with pytest.raises(holdfast.MessageError, match="stamps_ns: must be within 5 and 5"):
            track.interpolate([stamp_ns])


def test_a_trajectory_without_poses_is_known_nowhere():
    """It ended in an IndexError."""
    assert len(no_poses().interpolate(np.zeros(0, dtype=np.int64))) == 0
    assert repr(no_poses()) == "Trajectory(0 poses, 0.0 s, 0.0 m)"
    with pytest.raises(holdfast.MessageError, match="stamps_ns: must be empty, this trajectory has no poses"):
        no_poses().interpolate([5])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"quaternions_xyzw": np.zeros((50, 4))},
            r"quaternions_xyzw: must be of unit norm, got \[0.0, 0.0, 0.0, 0.0\]",
        ),
        ({"positions": np.full((50, 3), np.nan)}, "positions: must be finite, got .nan, nan, nan. at 0 .ns."),
        ({"covariances": np.full((50, 9, 9), np.inf)}, "covariances: must be finite"),
    ],
)
def test_poses_that_could_not_be_read_again_are_not_written(tmp_path, changes, words):
    turning().write(tmp_path / "track.tum")
    with pytest.raises(holdfast.MessageError, match=words):
        dataclasses.replace(turning(), **changes).write(tmp_path / "track.tum")
    assert len(holdfast.Trajectory.read(tmp_path / "track.tum")) == 50


def test_values_that_are_masked_are_refused():
    """What lies under a mask was taken for what is known."""
    track = turning()
    masked = np.ma.masked_array(track.positions, mask=track.positions > track.positions.mean())
    with pytest.raises(holdfast.MessageError, match="positions: must not be masked"):
        holdfast.Trajectory(track.stamps_ns, masked, track.quaternions_xyzw)
