"""CSV folders: one file per topic, columns with units."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.errors import RecordingError
from holdfast.messages import FixStatus
from holdfast.recording.source import Subscription, open_recording

IMU = "stamp_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n"
FLOATS = st.floats(allow_nan=True, allow_infinity=True)


def folder(tmp_path: Path, **files: str) -> Path:
    for name, text in files.items():
        (tmp_path / f"{name}.csv").write_text(text)
    return tmp_path


def read(path: Path, topic: str, kind: str):
    with open_recording(path) as recording:
        return list(recording.read([Subscription(topic, "s", kind)])), list(recording.warnings)


def test_every_kind_of_file_is_read(tmp_path: Path) -> None:
    folder(
        tmp_path,
        imu=IMU + "10,0.1,0.2,0.3,1,2,9.8\n",
        gnss="stamp_ns,arrival_ns,latitude_deg,longitude_deg,altitude_m,status,sigma_east_m,sigma_north_m,sigma_up_m\n"
        "11,13,49.1,8.4,116.5,2,0.1,0.2,0.3\n12,14,49.1,8.4,116.5,nan,,,\n",
        lidar="x_m,y_m,z_m,qx,qy,qz,qw,stamp_ns\n1,2,3,0,0,0,1,15\n",
        heading="stamp_ns,yaw_rad,sigma_rad\n16,0.5,0.01\n17,0.6,\n",
        joint="stamp_ns,angle_rad\n18,1.5\n",
    )
    (imu,), _ = read(tmp_path, "imu", "imu")
    assert (imu.stamp_ns, imu.arrival_ns, imu.sensor) == (10, 10, "s")
    assert imu.angular_velocity.tolist() == [0.1, 0.2, 0.3]
    assert imu.specific_force.tolist() == [1.0, 2.0, 9.8]
    (known, unknown), _ = read(tmp_path, "gnss", "gnss")
    assert (known.stamp_ns, known.arrival_ns) == (11, 13)
    assert (known.latitude_deg, known.longitude_deg, known.altitude_m) == (49.1, 8.4, 116.5)
    assert known.status is FixStatus.GBAS
    np.testing.assert_allclose(known.covariance, np.diag([0.01, 0.04, 0.09]))
    assert unknown.covariance is None
    assert unknown.status is FixStatus.UNKNOWN
    (pose,), _ = read(tmp_path, "lidar", "odometry")
    assert (pose.stamp_ns, pose.position.tolist(), pose.quaternion.tolist()) == (15, [1, 2, 3], [0, 0, 0, 1])
    headings, _ = read(tmp_path, "heading", "heading")
    assert [(h.yaw_rad, h.sigma_rad) for h in headings] == [(0.5, 0.01), (0.6, None)]
    (joint,), _ = read(tmp_path, "joint", "joint")
    assert joint.angle_rad == 1.5


def test_files_of_velocities_positions_and_heights_are_read_with_and_without_sigmas(tmp_path: Path) -> None:
    folder(
        tmp_path,
        wheels="stamp_ns,vx_m_s,vy_m_s,vz_m_s\n1,2,0.1,0\n",
        tracks="stamp_ns,vx_m_s,vy_m_s,vz_m_s,wx_rad_s,wy_rad_s,wz_rad_s,sigma_vx_m_s,sigma_vy_m_s,sigma_vz_m_s\n"
        "1,2,0,0,0,0,0.5,0.1,0.2,0.3\n2,2,0,0,0,0,0.5,,,\n",
        doppler="stamp_ns,v_east_m_s,v_north_m_s,v_up_m_s,sigma_v_east_m_s,sigma_v_north_m_s,sigma_v_up_m_s\n"
        "1,2,3,nan,0.1,0.2,\n2,2,3,0,,,\n",
        prism="stamp_ns,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n1,4,5,6,0.1,0.2,0.3\n",
        laser="stamp_ns,height_m,sigma_m\n1,7,0.02\n2,8,\n",
    )
    (wheels,), _ = read(tmp_path, "wheels", "twist")
    assert wheels.linear.tolist() == [2.0, 0.1, 0.0]
    assert np.isnan(wheels.angular).all()  # nobody measured it
    assert wheels.covariance is None
    (known, unknown), _ = read(tmp_path, "tracks", "twist")
    assert known.angular.tolist() == [0.0, 0.0, 0.5]
    np.testing.assert_allclose(known.covariance, np.diag([0, 0, 0, 0.01, 0.04, 0.09]))
    assert unknown.covariance is None
    (flat, unknown), _ = read(tmp_path, "doppler", "gnss_velocity")
    np.testing.assert_array_equal(flat.velocity, [2.0, 3.0, np.nan])
    np.testing.assert_array_equal(flat.covariance.diagonal(), np.array([0.1, 0.2, np.nan]) ** 2)
    assert unknown.covariance is None
    (prism,), _ = read(tmp_path, "prism", "prism")
    assert prism.position.tolist() == [4.0, 5.0, 6.0]
    np.testing.assert_allclose(prism.covariance, np.diag([0.01, 0.04, 0.09]))
    heights, _ = read(tmp_path, "laser", "height")
    assert [(one.height_m, one.sigma_m) for one in heights] == [(7.0, 0.02), (8.0, None)]


def test_a_file_serves_every_kind_that_has_its_columns(tmp_path: Path) -> None:
    folder(tmp_path, track="stamp_ns,x_m,y_m,z_m,qx,qy,qz,qw\n1,1,2,3,0,0,0,1\n", imu=IMU + "1,0,0,0,0,0,9.8\n")
    for kind in ("odometry", "pose"):
        (pose,), _ = read(tmp_path, "track", kind)
        assert pose.position.tolist() == [1.0, 2.0, 3.0]
    for kind in ("imu", "base_imu"):
        assert len(read(tmp_path, "imu", kind)[0]) == 1
    with pytest.raises(RecordingError, match="with the columns of odometry or pose, which is no prism"):
        read(tmp_path, "track", "prism")


@given(rows=st.lists(st.tuples(st.integers(0, 2**63 - 1), *[FLOATS] * 6), min_size=1, max_size=20))
def test_imu_rows_survive_the_way_through_a_file_bit_by_bit(tmp_path_factory: pytest.TempPathFactory, rows) -> None:
    rows.sort(key=lambda row: row[0])
    path = tmp_path_factory.mktemp("csv")
    folder(path, imu=IMU + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    messages, warnings = read(path, "imu", "imu")
    assert [m.stamp_ns for m in messages] == [row[0] for row in rows]
    values = [[*m.angular_velocity, *m.specific_force] for m in messages]
    np.testing.assert_array_equal(values, [row[1:] for row in rows])
    assert warnings == []


def test_files_are_merged_by_arrival_and_the_window_is_by_arrival(tmp_path: Path) -> None:
    folder(
        tmp_path,
        imu=IMU + "".join(f"{k * 10**9},0,0,0,0,0,0\n" for k in range(10)),
        heading="stamp_ns,arrival_ns,yaw_rad\n" + "".join(f"{k * 10**9},{(k + 2) * 10**9 + 1},0\n" for k in range(10)),
    )
    both = [Subscription("imu", "i", "imu"), Subscription("heading", "h", "heading")]
    with open_recording(tmp_path) as recording:
        assert (recording.start_ns, recording.end_ns) == (0, 11 * 10**9 + 1)
        arrivals = [m.arrival_ns for m in recording.read(both)]
        assert len(arrivals) == 20
        assert arrivals == sorted(arrivals)
        window = [(m.sensor, m.stamp_ns // 10**9) for m in recording.read(both, 3, 2)]
        headers = list(recording.read_headers())
    assert window == [("i", 3), ("h", 1), ("i", 4), ("h", 2)]
    assert [h.arrival_ns for h in headers] == arrivals
    assert {h.publisher for h in headers} == {"imu.csv", "heading.csv"}


def test_the_header_of_euroc_is_understood(tmp_path: Path) -> None:
    header = (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\r\n"
    )
    (tmp_path / "data.csv").write_bytes((header + "1403636579758555392,-0.1,0.2,0.3,8.1,-0.3,-2.5\r\n").encode())
    (message,), _ = read(tmp_path, "data", "imu")
    assert message.stamp_ns == 1403636579758555392
    assert message.specific_force.tolist() == [8.1, -0.3, -2.5]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("stamp_ns,speed\n1,2\n", "imu.csv:1: the header names no known column"),
        (IMU.replace("wy_rad_s", "wy_deg_s"), "imu.csv:1: column wy_rad_s is missing"),
        ("stamp_ns,vx_m_s,vy_m_s,w_m_s,wx_rad_s,wy_rad_s,wz_rad_s\n", "imu.csv:1: column vz_m_s is missing"),
        ("stamp_ns,vx_m_s,vy_m_s,vz_m_s,wz_rad_s\n", "imu.csv:1: column wx_rad_s is missing (a file of kind twist"),
        ("stamp_ns,x_m,y_m,z_m,qx,qy,qz\n", "imu.csv:1: column qw is missing (a file of kind odometry"),
        (IMU.replace("stamp_ns,", ""), "imu.csv:1: column stamp_ns is missing"),
        ("temperature," + IMU, "imu.csv:1: column 'temperature' is unknown or there twice"),
        (IMU + "1,0,0,0,0,0,0\n2,0,zero,0,0,0,0\n", "imu.csv:3: column wy_rad_s is 'zero' (allowed: a number"),
        (IMU + "1,0,0,0,0,0,0\n2,0,,0,0,0,0\n", "imu.csv:3: column wy_rad_s is '' (allowed: a number"),
        (IMU + "1,0,0,1_0.5,0,0,0\n", "imu.csv:2: column wz_rad_s is '1_0.5' (allowed: a number"),
        (IMU + "1,0,0,\u0661\u0662,0,0,0\n", "imu.csv:2: column wz_rad_s is '\u0661\u0662' (allowed: a number"),
        (IMU + "1_0,0,0,0,0,0,0\n", "imu.csv:2: column stamp_ns is '1_0' (allowed: a whole number of nanoseconds"),
        (
            IMU + "1.5,0,0,0,0,0,0\n",
            "imu.csv:2: column stamp_ns is '1.5' (allowed: a whole number of nanoseconds in 64 bits)",
        ),
        (IMU + "1,0,0,0,0,0\n", "imu.csv:2: has 6 columns (allowed: 7, as above)"),
        (IMU, "holds no messages"),
    ],
)
def test_errors_name_file_line_and_column(tmp_path: Path, text: str, error: str) -> None:
    folder(tmp_path, imu=text)
    with pytest.raises(RecordingError) as caught:
        read(tmp_path, "imu", "imu")
    assert error in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_last_line_that_was_cut_off_is_left_out_with_a_warning(tmp_path: Path) -> None:
    folder(tmp_path, imu=IMU + "1,0,0,0,0,0,0\n\n# note\n2,0,0,0,0,0,0\n3,0,0")
    messages, (warning,) = read(tmp_path, "imu", "imu")
    assert [m.stamp_ns for m in messages] == [1, 2]
    assert "imu.csv:6: has 3 columns" in warning
    assert "cut off" in warning


def test_a_pose_without_a_rotation_is_skipped_and_counted(tmp_path: Path) -> None:
    folder(tmp_path, lidar="stamp_ns,x_m,y_m,z_m,qx,qy,qz,qw\n1,0,0,0,0,0,0,0\n2,0,0,0,0,0,0,1\n")
    messages, (warning,) = read(tmp_path, "lidar", "odometry")
    assert [m.stamp_ns for m in messages] == [2]
    assert "1 message of lidar could not be decoded" in warning


@pytest.mark.parametrize("status", ["9", "-3", "1.5", "1e300"])
def test_a_fix_whose_status_does_not_exist_is_skipped_and_counted(tmp_path: Path, status: str) -> None:
    """It was taken for a fix of low status."""
    header = "stamp_ns,latitude_deg,longitude_deg,altitude_m,status\n"
    folder(tmp_path, gnss=f"{header}1,49,8,0,{status}\n2,49,8,0,2\n")
    fixes, warnings = read(tmp_path, "gnss", "gnss")
    assert [fix.status for fix in fixes] == [FixStatus.GBAS]
    told = f"status is {float(status):g} (allowed: -2 UNKNOWN, -1 NO_FIX, 0 FIX, 1 SBAS, 2 GBAS, or nan)"
    assert warnings == [
        f"{tmp_path}: 1 message of gnss could not be decoded and was skipped, the first at 1 ns: {told}"
    ]


def test_rows_that_arrive_before_the_row_above_keep_their_place_with_a_warning(tmp_path: Path) -> None:
    folder(tmp_path, imu=IMU + "".join(f"{k},0,0,0,0,0,0\n" for k in (1, 5, 3, 6)))
    messages, (warning,) = read(tmp_path, "imu", "imu")
    assert [m.stamp_ns for m in messages] == [1, 5, 3, 6]
    assert "1 row(s) arrived before the row above" in warning


def test_a_foreign_file_in_the_folder_is_left_out_with_a_warning(tmp_path: Path) -> None:
    folder(tmp_path, imu=IMU + "1,0,0,0,0,0,0\n", notes="time,remark\n1,rain\n")
    messages, (warning,) = read(tmp_path, "imu", "imu")
    assert len(messages) == 1
    assert "notes.csv:1: the header names no known column" in warning


def test_wrong_kinds_and_absent_files_are_errors(tmp_path: Path) -> None:
    folder(tmp_path, imu=IMU + "1,0,0,0,0,0,0\n")
    with pytest.raises(RecordingError, match=r"imu\.csv: topic 'imu' is sensor_msgs/msg/Imu with the columns of imu"):
        read(tmp_path, "imu", "heading")
    with pytest.raises(RecordingError, match="has no topic 'imus'; did you mean 'imu'"):
        read(tmp_path, "imus", "imu")
