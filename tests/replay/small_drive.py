"""Twenty seconds of a machine that stands for three, then drives a circle; as a CSV folder, as an MCAP bag, and run.

Everything is planar and in closed form: the distance driven s(t) has a smooth start, the vehicle V yaws by
s / RADIUS_M. The IMU sits askew at the origin of V, so that no axis of I is one of the world.
"""

import contextlib
import io
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import gtsam
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "recording"))

from bags import HUMBLE, fix, imu, odometry, write_bag

from holdfast.cli import main
from holdfast.geometry.earth import Geodetic, LocalFrame

DATUM = Geodetic(47.4, 8.5, 450.0)
EPOCH_NS = 1_700_000_000_000_000_000
GRAVITY = 9.81
SECONDS = 20.0
STAND_S, RAMP_S, SPEED_M_S, RADIUS_M, YAW_RAD = 3.0, 4.0, 2.0, 6.0, 0.7
ARM = np.array([0.5, -0.3, 1.2])
SIGMAS_M = (0.02, 0.03, 0.05)
R_V_I = gtsam.Rot3.RzRyRx(0.1, -0.15, 0.4)
T_I_L = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.0, 0.1, 1.0), np.array([0.4, 0.2, 0.9]))
T_I_B = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 2.5), np.array([-1.1, 0.6, -1.7]))
IMU_DELAY_NS, GNSS_DELAY_NS, LIDAR_DELAY_NS = 1_000_000, 63_000_000, 21_000_000
HEADING_DEG = float(np.degrees((gtsam.Rot3.Yaw(YAW_RAD) * R_V_I).rpy()[2]))

TRACKS = ("imu_in_world", "imu_in_odom", "optimized_in_world", "smoothed_in_world")
WRITTEN = {"estimates.mcap", "events.jsonl", "measurements.csv", "summary.json", ".holdfast"}
FILES = {*(f"{track}.tum" for track in TRACKS), *WRITTEN}


def distance(t):
    """Distance driven and its first two derivatives [m, m/s, m/s^2]; the speed is a smooth step from 0 to SPEED_M_S."""
    x = min(max((t - STAND_S) / RAMP_S, 0.0), 1.0)
    beyond = max(0.0, t - STAND_S - RAMP_S)
    driven = RAMP_S * (x**3 - 0.5 * x**4) + beyond
    return SPEED_M_S * driven, SPEED_M_S * (3 * x**2 - 2 * x**3), SPEED_M_S * 6 * (x - x**2) / RAMP_S


def pose(t):
    """T_W_I."""
    yaw = YAW_RAD + distance(t)[0] / RADIUS_M
    x, y = RADIUS_M * (np.sin(yaw) - np.sin(YAW_RAD)), RADIUS_M * (np.cos(YAW_RAD) - np.cos(yaw))
    return gtsam.Pose3(gtsam.Rot3.Yaw(yaw) * R_V_I, np.array([x, y, 0.0]))


def antenna(t):
    """p_W_G (3,) [m]."""
    return pose(t).transformFrom(ARM)


def readings(t):
    """Angular velocity [rad/s] and specific force [m/s^2] of I."""
    _, speed, acceleration = distance(t)
    rate = np.array([0.0, 0.0, speed / RADIUS_M])
    force = np.array([acceleration, speed**2 / RADIUS_M, GRAVITY])
    return R_V_I.unrotate(rate), R_V_I.unrotate(force)


def stamp(t):
    return EPOCH_NS + round(t * 1e9)


@dataclass(frozen=True)
class Rows:
    """Per sensor: (stamp [ns], arrival [ns], values)."""

    imu: list
    gnss: list
    lidar: list


def make_rows(seconds=SECONDS, gnss_noise=1.0):
    """IMU at 100 Hz, GNSS at 5 Hz (quality, position, sigmas), lidar at 10 Hz; the same ones at every call."""
    rng = np.random.default_rng(7)
    rows = Rows([], [], [])
    for k in range(round(seconds * 100)):
        t = k / 100
        rate, force = readings(t)
        values = (*(rate + rng.normal(0, 1e-3, 3)), *(force + rng.normal(0, 1e-2, 3)))
        rows.imu.append((stamp(t), stamp(t) + IMU_DELAY_NS, values))
    for k in range(round(seconds * 5)):
        t = 0.004 + k / 5
        point = LocalFrame(DATUM).to_geodetic(antenna(t) + gnss_noise * rng.normal(0, SIGMAS_M, 3))
        rows.gnss.append((stamp(t), stamp(t) + GNSS_DELAY_NS, (*point, 2, *SIGMAS_M)))
    start = pose(0.0) * T_I_L
    for k in range(round(seconds * 10)):
        t = 0.007 + k / 10
        track = start.between(pose(t) * T_I_L)
        values = (*(track.translation() + rng.normal(0, 2e-3, 3)), *track.rotation().toQuaternion().coeffs())
        rows.lidar.append((stamp(t), stamp(t) + LIDAR_DELAY_NS, values))
    return rows


COLUMNS = {
    "imu": "wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2",
    "gnss": "latitude_deg,longitude_deg,altitude_m,status,sigma_east_m,sigma_north_m,sigma_up_m",
    "lidar": "x_m,y_m,z_m,qx,qy,qz,qw",
}


def write_csv(folder, rows=None):
    """Write a CSV folder and return it."""
    rows = rows or make_rows()
    folder.mkdir(parents=True, exist_ok=True)
    for name, columns in COLUMNS.items():
        lines = [f"stamp_ns,arrival_ns,{columns}\n"]
        for at, arrival, values in getattr(rows, name):
            lines.append(f"{at},{arrival}," + ",".join(repr(float(v)) for v in values) + "\n")
        (folder / f"{name}.csv").write_text("".join(lines).replace(",2.0,", ",2,"))
    return folder


def bag_messages(rows=None):
    """(topic, arrival, ROS message), sorted by arrival; the topics are the stems of the CSV files."""
    rows = rows or make_rows()
    messages = [("imu", arrival, imu(HUMBLE, at, rate=v[:3], force=v[3:])) for at, arrival, v in rows.imu]
    for at, arrival, v in rows.gnss:
        covariance = np.diag(np.square(v[4:])).ravel()
        messages.append(("gnss", arrival, fix(HUMBLE, at, status=v[3], cov=covariance, position=v[:3])))
    messages += [("lidar", arrival, odometry(HUMBLE, at, position=v[:3], xyzw=v[3:])) for at, arrival, v in rows.lidar]
    return sorted(messages, key=lambda row: row[1])


def write_mcap(path, rows=None):
    """Write a ROS 2 bag folder with one MCAP file and return it."""
    return write_bag(path, "mcap", bag_messages(rows))


def extrinsic(child, T):
    rotation = [[float(x) for x in row] for row in T.rotation().matrix()]
    return {"parent": "imu", "child": child, "translation_m": T.translation().tolist(), "rotation_matrix": rotation}


def config_text(base=False, datum=True, **sensors):
    """The configuration as YAML (JSON is YAML); keyword arguments change or, with None, drop a sensor."""
    settings = {
        "imu": {"kind": "imu", "topic": "imu"},
        "gnss": {"kind": "gnss", "topic": "gnss"},
        "lidar": {"kind": "odometry", "topic": "lidar"},
    }
    for name, change in sensors.items():
        settings[name] = None if change is None else settings.get(name, {}) | change
    arm = gtsam.Pose3(gtsam.Rot3(), ARM)
    extrinsics = [extrinsic("gnss", arm), extrinsic("lidar", T_I_L)]
    extrinsics += [extrinsic("base_link", T_I_B)] if base else []
    frames = {"gravity": GRAVITY}
    if datum:
        frames["datum"] = DATUM._asdict()
    return json.dumps(
        {
            "sensors": {name: setting for name, setting in settings.items() if setting is not None},
            "extrinsics": extrinsics,
            "frames": frames,
            "initialisation": {"heading_deg": HEADING_DEG},
        },
        indent=1,
    )


def write_config(path, **changes):
    path.write_text(config_text(**changes))
    return path


@dataclass(frozen=True)
class Done:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


def holdfast(*arguments):
    """Run the command line in this process, as the console script does."""
    out, err = io.StringIO(), io.StringIO()
    code = 0
    with (
        mock.patch.object(sys, "argv", ["holdfast", *map(str, arguments)]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as stop:
            code = stop.code or 0
    return Done(code, out.getvalue(), err.getvalue())


def summary(folder):
    return json.loads((folder / "summary.json").read_text(), parse_constant=_refuse)


def events(folder):
    return [json.loads(line, parse_constant=_refuse) for line in (folder / "events.jsonl").read_text().splitlines()]


def _refuse(constant):
    raise AssertionError(f"{constant} is no JSON")


def poses(track):
    """The poses of a `Trajectory` by stamp."""
    return {
        at: gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), p)
        for at, p, (x, y, z, w) in zip(track.stamps_ns.tolist(), track.positions, track.quaternions, strict=True)
    }
