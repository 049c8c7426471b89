"""A walled yard with containers, seen by a spinning lidar on a cabin that slews; everything in closed form.

The lidar turns clockwise at 5 Hz and looks 3 m above the ground. The cabin's axis is the z axis of the world.
"""

import gtsam
import numpy as np
from bags import header

from holdfast.lidar_odometry.deskew import Rates
from holdfast.lidar_odometry.sweep import Sweep

START_NS = 1_700_000_000_000_000_000
PERIOD_S = 0.2
COLUMNS = 256
ELEVATIONS_DEG = np.linspace(25.0, -45.0, 36)
ARM = np.array([0.8, 0.3, 3.0])
RATE_RAD_S, ACCELERATION_RAD_S2 = 0.6, 0.6
NOISE_M = 0.02
# corners of boxes: west, south, bottom, east, north, top
BOXES = np.array(
    [
        [-26, -19, 0, -25, 19, 5],
        [24, -19, 0, 25, 19, 4],
        [-25, -20, 0, 25, -19, 6],
        [-25, 18, 0, 25, 19, 3],
        [8, 5, 0, 14, 7.5, 2.6],
        [-12, 8, 0, -9.5, 14, 2.6],
        [-15, -9, 0, -12, -6, 2.0],
        [6, -12, 0, 7, -11, 4.0],
        [15, -4, 0, 16, -3, 6.0],
        [-6, -14, 0, -4, -13, 1.5],
    ],
    dtype=float,
)


def cast(origins, directions, boxes=BOXES):
    """Distance (N,) along unit rays to the ground z = 0 or a box [m]; inf where there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.where(directions[:, 2] < 0, -origins[:, 2] / directions[:, 2], np.inf)
        nearest = ground
        for box in boxes:
            sides = (np.stack([box[:3], box[3:]])[:, None] - origins) / directions
            enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
            nearest = np.where((enter < leave) & (enter > 0), np.minimum(nearest, enter), nearest)
    return nearest


def ramp(since, angle, rate=RATE_RAD_S, acceleration=ACCELERATION_RAD_S2):
    """Angle of a slew from standstill to standstill, and how long it lasts."""
    brake = rate / acceleration
    lasts = angle / rate + brake
    since = np.clip(since, 0.0, lasts)
    start = 0.5 * acceleration * since**2
    steady = rate * (since - 0.5 * brake)
    end = angle - 0.5 * acceleration * (lasts - since) ** 2
    return np.where(since < brake, start, np.where(since < lasts - brake, steady, end)), lasts


TURN_RAD = np.pi / 3
LASTS_S = float(ramp(0.0, TURN_RAD)[1])
SLEWED_S = 2.0 + 2 * LASTS_S


def slewed_rad(t):
    """Angle of the cabin: it stands for 0.6 s, slews by 60 deg and, after 0.4 s, back, and stands for a second."""
    t = np.asarray(t, dtype=float)
    return ramp(t - 0.6, TURN_RAD)[0] - ramp(t - 1.0 - LASTS_S, TURN_RAD)[0]


def slow_rad(t):
    """Angle of the cabin: it stands for 0.6 s and soon turns with a steady 0.2 rad/s."""
    return ramp(np.asarray(t, dtype=float) - 0.6, 10.0, 0.2, 1.0)[0]


def standing(t):
    return np.zeros_like(np.asarray(t, dtype=float))


def T_W_L(t, angle=slewed_rad, velocity=(0.0, 0.0, 0.0)):
    """Pose of the lidar at one time, on a cabin that also drives with a velocity [m/s]."""
    R = gtsam.Rot3.Yaw(float(angle(t)))
    return gtsam.Pose3(R, R.rotate(ARM) + t * np.asarray(velocity))


def spinning(elevations_deg=ELEVATIONS_DEG):
    """Unit vectors (COLUMNS, R, 3) in L of a lidar that turns."""
    azimuth, elevation = np.pi - 2 * np.pi * np.arange(COLUMNS) / COLUMNS, np.radians(elevations_deg)
    level = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(COLUMNS)], axis=1)
    return level[:, None] * np.cos(elevation)[:, None] + np.sin(elevation)[:, None] * np.array([0.0, 0.0, 1.0])


def through_prisms(rng, count=24):
    """Unit vectors (COLUMNS, count, 3) in L of a lidar that looks ahead, 40 deg to each side, anew in every sweep."""
    off_axis = np.radians(40.0) * np.sqrt(rng.uniform(0.0, 1.0, (COLUMNS, count)))
    about = rng.uniform(-np.pi, np.pi, (COLUMNS, count))
    return np.stack([np.cos(off_axis), np.sin(off_axis) * np.cos(about), np.sin(off_axis) * np.sin(about)], axis=-1)


def sweep(
    number,
    rng,
    angle=slewed_rad,
    *,
    gyroscope=False,
    times=True,
    noise_m=NOISE_M,
    velocity=(0.0, 0.0, 0.0),
    elevations_deg=ELEVATIONS_DEG,
    rays=None,
):
    """One sweep of the lidar, stamped at its start; it turns unless its rays (COLUMNS, R, 3) are given."""
    start_s = number * PERIOD_S
    offsets_s = np.arange(COLUMNS) / COLUMNS * PERIOD_S
    rays = spinning(elevations_deg) if rays is None else rays
    poses = [T_W_L(start_s + offset_s, angle, velocity) for offset_s in offsets_s]
    turned = np.einsum("cij,crj->cri", [pose.rotation().matrix() for pose in poses], rays)
    origins = np.repeat([pose.translation() for pose in poses], rays.shape[1], axis=0)
    distance = cast(origins, turned.reshape(-1, 3))
    seen = np.isfinite(distance)
    distance = distance[seen] + noise_m * rng.standard_normal(int(seen.sum()))
    rates = None
    if gyroscope:
        at_s = np.arange(-0.5, 0.21, 0.01)
        rate = (angle(start_s + at_s + 1e-3) - angle(start_s + at_s - 1e-3)) / 2e-3
        forces = np.tile([0.0, 0.0, 9.81], (len(at_s), 1))  # the IMU is on the axis
        rates = Rates(at_s, np.column_stack([np.zeros((len(at_s), 2)), rate]), forces, ARM)
    return Sweep(
        START_NS + round(start_s * 1e9),
        "lidar",
        rays.reshape(-1, 3)[seen] * distance[:, None],
        np.repeat(offsets_s, rays.shape[1])[seen] if times else None,
        rates,
    )


def rays_that_return(rng, elevations_deg=ELEVATIONS_DEG):
    """Unit vectors (N, 3) in L along which the lidar sees the yard from where it starts."""
    points = sweep(0, rng, standing, times=False, noise_m=0.0, elevations_deg=elevations_deg).points
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def error(registered, first, angle=slewed_rad):
    """Residual of a pose against the truth at its stamp, as a tangent (6,): rotation [rad], translation [m]."""
    started = T_W_L((first.stamp_ns - START_NS) * 1e-9, angle)
    truth = started.between(T_W_L((registered.stamp_ns - START_NS) * 1e-9, angle))
    return gtsam.Pose3.Logmap(truth.between(gtsam.Pose3(registered.T_L0_L)))


FORMATS = {"f4": 7, "f8": 8, "u4": 6, "u2": 4, "i4": 5, "u1": 2}


def cloud(store, stamp_ns, columns, *, big_endian=False, row_padding=0, height=1, frame_id="lidar", step=None):
    """A sensor_msgs/PointCloud2 of (name, format, values) columns."""
    order = ">" if big_endian else "<"
    layout = [(name, order + form) for name, form, _ in columns]
    packed = np.dtype(layout)
    dtype = np.dtype(
        {
            "names": [name for name, _ in layout],
            "formats": [form for _, form in layout],
            "offsets": [packed.fields[name][1] for name, _ in layout],
            "itemsize": step or packed.itemsize,
        }
    )
    records = np.zeros(len(columns[0][2]), dtype=dtype)
    for name, _, values in columns:
        records[name] = values
    width = len(records) // height
    rows = records.view(np.uint8).reshape(height, width * dtype.itemsize)
    rows = np.hstack([rows, np.full((height, row_padding), 255, dtype=np.uint8)])
    types = store.types
    fields = [
        types["sensor_msgs/msg/PointField"](name=name, offset=dtype.fields[name][1], datatype=FORMATS[form], count=1)
        for name, form, _ in columns
    ]
    return types["sensor_msgs/msg/PointCloud2"](
        header=header(store, stamp_ns, frame_id),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=big_endian,
        point_step=dtype.itemsize,
        row_step=rows.shape[1],
        data=np.ascontiguousarray(rows).ravel(),
        is_dense=True,
    )


def message(store, swept, frame_id="lidar"):
    """A sweep as a driver publishes it: float32, times as uint32 nanoseconds."""
    columns = [(axis, "f4", swept.points[:, k]) for k, axis in enumerate("xyz")]
    if swept.offsets_s is not None:
        columns.append(("t", "u4", np.rint(swept.offsets_s * 1e9)))
    return cloud(store, swept.stamp_ns, columns, frame_id=frame_id)
