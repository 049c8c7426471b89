import numpy as np
import pytest
from bags import HUMBLE, NOETIC
from yard import START_NS, cloud

from holdfast.lidar_odometry.sweep import decode_sweep
from holdfast.recording.decode import UndecodableError

POINTS = np.array([[1.5, -2.0, 0.25], [10.0, 20.0, -3.0], [0.5, 0.0, 4.0], [-7.0, 1.0, 2.0]])
TIMES_S = np.array([0.0, 0.05, 0.1, 0.15])


def axes(form="f4"):
    return [(axis, form, POINTS[:, k]) for k, axis in enumerate("xyz")]


def decode(columns, store=HUMBLE, **options):
    return decode_sweep(cloud(store, START_NS, columns, **options))


@pytest.mark.parametrize("store", [HUMBLE, NOETIC], ids=["ROS 2", "ROS 1"])
@pytest.mark.parametrize("form", ["f4", "f8"])
@pytest.mark.parametrize(
    "layout",
    [{}, {"step": 48}, {"height": 2}, {"height": 2, "row_padding": 7}, {"big_endian": True}],
    ids=["packed", "padded points", "two rows", "padded rows", "big-endian"],
)
def test_points_and_times_are_read_whatever_the_layout(store, form, layout):
    columns = [("ring", "u2", [9, 8, 7, 6]), *axes(form), ("t", "u4", TIMES_S * 1e9)]
    sweep = decode(columns, store, **layout)
    np.testing.assert_array_equal(sweep.points, POINTS)
    np.testing.assert_allclose(sweep.offsets_s, TIMES_S, atol=1e-12)
    assert (sweep.stamp_ns, sweep.frame_id) == (START_NS, "lidar")
    assert sweep.points.dtype == np.float64


@pytest.mark.parametrize(
    ("name", "form", "values"),
    [
        ("t", "u4", TIMES_S * 1e9),
        ("offset_time", "u4", TIMES_S * 1e9),
        ("time", "f4", TIMES_S),
        ("timestamp", "f8", TIMES_S),
        ("timestamp", "f8", START_NS * 1e-9 + TIMES_S),
        ("timestamp", "f8", START_NS + TIMES_S * 1e9),
    ],
    ids=["ns", "Livox ns", "float32 s", "float64 s", "float64 s since the epoch", "float64 ns since the epoch"],
)
def test_times_count_from_the_stamp_whatever_their_unit_and_origin(name, form, values):
    # float64 seconds since the epoch resolve 0.24 us, float64 nanoseconds 0.26 us
    np.testing.assert_allclose(decode([*axes(), (name, form, values)]).offsets_s, TIMES_S, atol=3e-7)


@pytest.mark.parametrize(("name", "form"), [("intensity", "f4"), ("reflectivity", "u2"), ("signal", "u1")])
def test_intensities_are_read_and_stay_with_their_points(name, form):
    sweep = decode([*axes(), (name, form, [10, 20, 30, 40])])
    np.testing.assert_array_equal(sweep.intensities, [10.0, 20.0, 30.0, 40.0])
    np.testing.assert_array_equal(sweep.beyond(5.0).intensities, [20.0, 40.0])
    assert decode(axes()).intensities is None


def test_times_before_the_stamp_are_negative():
    sweep = decode([*axes(), ("time", "f4", TIMES_S - 0.15)])
    np.testing.assert_allclose(sweep.offsets_s, TIMES_S - 0.15, atol=1e-7)
    assert sweep.middle_s == pytest.approx(-0.075)


def test_points_that_are_not_finite_are_left_out_with_their_times():
    bad = POINTS.copy()
    bad[1, 2], bad[3, 0] = np.nan, np.inf
    sweep = decode([*((axis, "f4", bad[:, k]) for k, axis in enumerate("xyz")), ("t", "u4", TIMES_S * 1e9)])
    np.testing.assert_array_equal(sweep.points, POINTS[[0, 2]])
    np.testing.assert_allclose(sweep.offsets_s, TIMES_S[[0, 2]])


@pytest.mark.parametrize("extra", [[], [("t", "u4", [7, 7, 7, 7])]], ids=["no field", "all equal"])
def test_without_times_the_pose_belongs_to_the_stamp(extra):
    sweep = decode([*axes(), *extra])
    assert sweep.offsets_s is None
    assert sweep.middle_s == 0.0


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        (axes()[:2], "no fields x, y, z"),
        ([*axes(), ("time", "f4", TIMES_S + 30.0)], "is 30.1 s from the stamp"),
        ([*axes(), ("timestamp", "f8", START_NS * 1e-9 + 3600.0 + TIMES_S)], "from the stamp"),
        ([*axes(), ("time", "f4", [0.0, np.nan, 0.1, 0.2])], "not finite"),
    ],
)
def test_what_is_no_sweep_is_refused_with_a_reason(columns, reason):
    with pytest.raises(UndecodableError, match=reason):
        decode(columns)


def test_data_that_are_cut_off_are_refused():
    message = cloud(HUMBLE, START_NS, axes())
    message.data = message.data[:-1]
    with pytest.raises(UndecodableError, match="do not fit"):
        decode_sweep(message)


def test_points_nearer_than_a_range_are_left_out_with_their_times():
    sweep = decode([*axes(), ("t", "u4", TIMES_S * 1e9)]).beyond(5.0)
    np.testing.assert_array_equal(sweep.points, POINTS[[1, 3]])
    np.testing.assert_allclose(sweep.offsets_s, TIMES_S[[1, 3]])


def test_a_cloud_without_points_is_a_sweep_without_points():
    sweep = decode([(name, form, []) for name, form, _ in axes()] + [("t", "u4", [])])
    assert sweep.points.shape == (0, 3)
    assert sweep.middle_s == 0.0
