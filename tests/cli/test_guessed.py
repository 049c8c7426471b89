"""`holdfast replay` without a configuration: it runs with what the bag tells, says what it assumed, and keeps it."""

import sys
from pathlib import Path

import gtsam
import numpy as np
import pytest

sys.path += [str(Path(__file__).parents[1] / room) for room in ("replay", "recording")]

from bags import HUMBLE
from small_drive import ARM, T_I_L, bag_messages, holdfast, make_rows, write_bag, write_csv, write_mcap
from test_recorded_frames import told, transform

from holdfast.config.load import load_config
from holdfast.recording.tum import read_tum

FILE = "guessed_config.yaml"


def framed(rows):
    """The messages of the small drive, each with the frame of its sensor, and /tf_static before them."""
    messages = []
    for topic, arrival, message in bag_messages(rows):
        message.header.frame_id = f"{topic}_link"
        if topic == "lidar":
            message.child_frame_id = "lidar_link"
        messages.append((topic, arrival, message))
    stamp = messages[0][1]
    lidar = transform(HUMBLE, stamp, "imu_link", "lidar_link", T_I_L.translation())
    q = gtsam.Rot3(T_I_L.rotation().matrix()).toQuaternion()
    lidar.transform.rotation = HUMBLE.types["geometry_msgs/msg/Quaternion"](q.x(), q.y(), q.z(), q.w())
    mounts = told(HUMBLE, "/tf_static", stamp - 1, transform(HUMBLE, stamp, "imu_link", "gnss_link", ARM), lidar)
    return [mounts, *messages]


@pytest.fixture(scope="module")
def with_mounts(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("drive") / "bag", "mcap", framed(make_rows()))


def test_a_bag_that_holds_its_mounts_is_replayed_without_a_configuration(with_mounts, tmp_path):
    done = holdfast("replay", with_mounts, "-o", tmp_path / "out", "--hold-out", "gnss=2")
    assert done.code == 0
    lines = done.err.splitlines()
    assert lines[0].startswith("warning: no configuration was given (-c), so this is a GUESS")
    arm_m, lidar_m = np.linalg.norm(ARM), np.linalg.norm(T_I_L.translation())
    assert f"  gnss: gnss, {arm_m:.2f} m from imu_link (from /tf_static: imu_link - gnss_link)" in lines
    assert f"  lidar: lidar, {lidar_m:.2f} m from imu_link (from /tf_static: imu_link - lidar_link)" in lines
    assert f"{tmp_path / 'out'}/{FILE}" in lines[-1]
    config = load_config(tmp_path / "out" / FILE)
    np.testing.assert_allclose(config.T_I("gnss_link")[:3, 3], ARM, atol=1e-8)
    np.testing.assert_allclose(config.T_I("lidar_link"), T_I_L.matrix(), atol=1e-7)
    assert float(done.out.split("horizontal RMS ")[1].split(" m")[0]) < 0.1


def test_the_guess_is_a_configuration_that_gives_the_same_again(with_mounts, tmp_path):
    assert holdfast("replay", with_mounts, "-o", tmp_path / "a", "--duration", 9).code == 0
    again = holdfast("replay", with_mounts, "-c", tmp_path / "a" / FILE, "-o", tmp_path / "b", "--duration", 9)
    assert (again.code, again.err) == (0, "")
    first, second = (read_tum(tmp_path / name / "imu_in_world.tum") for name in "ab")
    np.testing.assert_array_equal(first.positions, second.positions)
    assert not (tmp_path / "b" / FILE).exists()


def test_sensors_without_a_mount_are_left_out_aloud_and_one_antenna_is_assumed_at_the_imu(tmp_path):
    bag = write_mcap(tmp_path / "bag", make_rows())
    done = holdfast("replay", bag, "-o", tmp_path / "out")
    assert done.code == 0
    assert "  gnss: gnss, ASSUMED to sit in imu with the same axes: its mount is not in the recording" in done.err
    assert "  left out: lidar (lidar): the recording does not say how it is mounted" in done.err
    assert list(load_config(tmp_path / "out" / FILE).sensors) == ["imu", "gnss"]


def test_a_folder_of_csv_files_is_replayed_without_a_configuration_too(tmp_path):
    folder = write_csv(tmp_path / "csv", make_rows(seconds=9.0))
    done = holdfast("replay", folder, "-o", tmp_path / "out")
    assert done.code == 0
    assert "GUESS" in done.err


def test_a_held_out_sensor_that_was_not_guessed_is_refused_before_anything_is_written(with_mounts, tmp_path):
    done = holdfast("replay", with_mounts, "-o", tmp_path / "out", "--hold-out", "prism=2")
    assert done.code == 2
    assert "prism" in done.err.splitlines()[-1]
    assert not (tmp_path / "out").exists()
