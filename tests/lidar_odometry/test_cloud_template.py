"""Clouds as drivers lay them out, and clouds that claim what they do not hold."""

import numpy as np
import pytest
from bags import HUMBLE
from hypothesis import given
from hypothesis import strategies as st
from yard import START_NS, cloud

from holdfast.lidar_odometry.cloud_template import MAX_POINTS, CloudTemplate
from holdfast.lidar_odometry.sweep import decode_sweep, sweep_of
from holdfast.point_cloud import Layout, PointCloud, PointField
from holdfast.recording.decode import UndecodableError

SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 8: 8}
FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
XYZ = tuple(PointField(name, 4 * k, 7, 1) for k, name in enumerate("xyz"))

# the layouts of the drivers' own sources: field, format, byte at which it lies; step of a point
DRIVERS = {
    "ouster": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("intensity", "f4", 16), ("t", "u4", 20),
                ("reflectivity", "u2", 24), ("ring", "u2", 26), ("ambient", "u2", 28), ("range", "u4", 32)], 48),
    "velodyne": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("intensity", "f4", 12), ("ring", "u2", 16),
                  ("time", "f4", 18)], 22),
    "hesai": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("intensity", "f4", 16), ("timestamp", "f8", 24),
               ("ring", "u2", 32)], 48),
    "livox": ([("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8), ("intensity", "f4", 12), ("tag", "u1", 16),
               ("line", "u1", 17), ("timestamp", "f8", 18)], 26),
}  # fmt: skip
TIMES_S = np.linspace(0.0, 0.0999, 8)
IN_DRIVER_UNITS = {
    "ouster": np.rint(TIMES_S * 1e9),
    "velodyne": TIMES_S,
    "hesai": START_NS * 1e-9 + TIMES_S,
    "livox": START_NS + TIMES_S * 1e9,
}


def of_driver(name):
    """Eight points as a driver lays them out, in two rows."""
    fields, step = DRIVERS[name]
    dtype = np.dtype({"names": [f for f, _, _ in fields], "formats": ["<" + f for _, f, _ in fields],
                      "offsets": [at for _, _, at in fields], "itemsize": step})  # fmt: skip
    points = np.random.default_rng(1).normal(0, 20, (8, 3)).astype(np.float32)
    records = np.zeros(8, dtype)
    for k, axis in enumerate("xyz"):
        records[axis] = points[:, k]
    records[next(f for f in ("t", "time", "timestamp") if f in dtype.names)] = IN_DRIVER_UNITS[name]
    codes = {form: code for code, form in FORMATS.items()}
    layout = Layout(tuple(PointField(f, at, codes[form], 1) for f, form, at in fields), 2, 4, step, 4 * step, False)
    return PointCloud(START_NS, START_NS, "lidar", "os_sensor", layout, records.view(np.uint8).ravel()), points


@pytest.mark.parametrize("driver", DRIVERS)
def test_points_and_times_of_the_usual_drivers_are_read(driver):
    cloud_, points = of_driver(driver)
    sweep = sweep_of(cloud_)
    np.testing.assert_array_equal(sweep.points, points)
    np.testing.assert_allclose(sweep.offsets_s, TIMES_S, atol=3e-7)  # float64 since the epoch resolves 0.25 us


@pytest.mark.parametrize("driver", DRIVERS)
def test_coordinates_that_lie_evenly_are_read_without_a_copy(driver):
    cloud_, _ = of_driver(driver)
    template = CloudTemplate(cloud_.layout, cloud_.data.size)
    assert np.shares_memory(template.points(cloud_.data), cloud_.data)
    assert np.shares_memory(template.times(cloud_.data), cloud_.data)


@st.composite
def layouts(draw):
    """(fields, step, height, width, padding of rows, big-endian) of a sound cloud; fields in any order, with gaps."""
    names = draw(st.permutations(["x", "y", "z", *draw(st.sets(st.sampled_from(["ring", "t", "intensity", "tag"])))]))
    fields, at = [], 0
    for name in names:
        at += draw(st.integers(0, 5))
        kind = draw(st.sampled_from([7, 8] if name in "xyz" else [6] if name == "t" else [1, 2, 3, 4, 5, 6, 7, 8]))
        fields.append(PointField(name, at, kind, 1))
        at += SIZES[kind]
    step = at + draw(st.integers(0, 9))
    rows = draw(st.integers(0, 4)), draw(st.integers(0, 7)), draw(st.integers(0, 9))
    return tuple(fields), step, *rows, draw(st.booleans())


@given(layouts(), st.integers(0, 2**32 - 1))
def test_any_layout_gives_the_points_that_were_put_in(laid, seed):
    fields, step, height, width, padding, big = laid
    rng, order = np.random.default_rng(seed), ">" if big else "<"
    row = width * step + padding
    data = rng.integers(0, 256, height * row, dtype=np.uint8)
    points = rng.normal(0, 30, (height, width, 3)).astype(np.float32)
    times = np.sort(rng.integers(0, 10**8, (height, width)))
    for h in range(height):
        for w in range(width):
            for field in fields:
                at = h * row + w * step + field.offset
                value = points[h, w]["xyz".index(field.name)] if field.name in "xyz" else times[h, w]
                if field.name in ("x", "y", "z", "t"):
                    raw = np.array([value], order + FORMATS[field.datatype]).view(np.uint8)
                    data[at : at + len(raw)] = raw
    layout = Layout(fields, height, width, step, row, big)
    sweep = sweep_of(PointCloud(START_NS, 0, "lidar", "lidar", layout, data))
    np.testing.assert_array_equal(sweep.points, points.reshape(-1, 3))
    if any(field.name == "t" for field in fields) and len(set(times.ravel())) > 1:
        np.testing.assert_allclose(sweep.offsets_s, times.ravel() * 1e-9, rtol=0, atol=1e-12)


CLAIMS = st.integers(-(2**31), 2**32 - 1) | st.integers(0, 200)


@given(CLAIMS, CLAIMS, CLAIMS, CLAIMS, st.lists(st.tuples(st.sampled_from("xyzt"), CLAIMS, CLAIMS, CLAIMS), max_size=5))
def test_whatever_a_cloud_claims_it_is_read_within_its_bytes_or_refused(height, width, step, row, fields):
    layout = Layout((*XYZ, *(PointField(*field) for field in fields)), height, width, step, row, False)
    data = np.zeros(400, np.uint8)
    try:
        sweep = sweep_of(PointCloud(START_NS, 0, "lidar", "lidar", layout, data))
    except UndecodableError as error:
        assert "\n" not in str(error)
    else:
        assert len(sweep.points) == height * width
        assert height * width == 0 or (height - 1) * row + width * step <= data.size


def test_more_points_than_any_lidar_has_are_refused_before_anything_is_allocated():
    layout = Layout(XYZ, 1, MAX_POINTS + 1, 12, 12 * (MAX_POINTS + 1), False)
    with pytest.raises(UndecodableError, match="claims 1 x 4194305 points"):
        CloudTemplate(layout, 1 << 40)


def test_a_field_beyond_its_point_is_refused():
    columns = [(axis, "f4", [1.0, 2.0]) for axis in "xyz"]
    message = cloud(HUMBLE, START_NS, columns)
    message.fields[2].offset = 9
    with pytest.raises(UndecodableError, match="z at byte 9 of 12"):
        decode_sweep(message)
