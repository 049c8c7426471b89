"""Readings of every kind of sensor on a wide circle, healthy and struck by a fault."""

from functools import partial

import numpy as np
from sampled import sampled
from scipy.spatial.transform import Rotation

from holdfast.sim.fault import Fault
from holdfast.sim.faults import apply_faults, can_happen
from holdfast.sim.readings import Readings, generator
from holdfast.sim.scene import FrameMotion
from holdfast.sim.sensors import AnySheet
from holdfast.sim.sensors.gnss import Antenna, Quality, gnss_readings
from holdfast.sim.sensors.heading import heading_readings

DURATION_S = 40.0


def sheet(kind, **values):
    return AnySheet.kinds[kind](kind=kind, **{"topic": "/t", "frame": "f", "rate_hz": 10.0} | values)


GNSS = sheet("gnss", shared_ratio=0.3)
SHEETS = {
    "imu": sheet("imu"),
    "base_imu": sheet("base_imu"),
    "gnss": GNSS,
    "gnss_right": GNSS,
    "heading": sheet("heading"),
    "joint": sheet("joint"),
    "lidar": sheet("odometry"),
    "scanner": sheet("scanner"),
    "wheels": sheet("twist"),
    "doppler": sheet("gnss_velocity"),
    "markers": sheet("pose"),
    "prism": sheet("prism", station_m=(50.0, 0.0, 2.0)),
    "mast": sheet("height"),
}
FIXES = ("gnss", "gnss_right")


def drive(times_s, arm_m):
    """A machine that drives a wide circle."""
    attitude = Rotation.from_euler("z", (0.1 * times_s)[:, None])
    center = 20.0 * np.stack([np.sin(0.1 * times_s), 1.0 - np.cos(0.1 * times_s), 0.0 * times_s], axis=1)
    zero = np.zeros_like(center)
    return FrameMotion(attitude.as_matrix(), center + attitude.apply(arm_m), zero, zero, zero)


def measure(seed=0, right_rate_hz=10.0, quality=Quality.RTK_FIXED):
    rng = np.random.default_rng(seed)
    times = {name: np.arange(0.0, DURATION_S, 0.1) for name in SHEETS}
    times["gnss_right"] = np.arange(0.0, DURATION_S, 1.0 / right_rate_hz)
    fixed = {name: np.full(len(at), int(quality)) for name, at in times.items()}
    left, right = ({name: drive(times[name], [0.0, side, 3.0]) for name in times} for side in (1.0, -1.0))
    moving = {"gnss": left["gnss"], "gnss_right": right["gnss_right"]}
    antennas = {name: Antenna(GNSS, times[name], frame.p_W, fixed[name]) for name, frame in moving.items()}
    readings = gnss_readings(antennas, partial(generator, seed))
    for name in ("imu", "base_imu"):
        columns = ("angular_velocity", "specific_force", "gyroscope_bias")
        readings[name] = Readings(times[name], {column: rng.normal(size=(len(times[name]), 3)) for column in columns})
    ends = (Antenna(GNSS, times["heading"], side["heading"].p_W, fixed["heading"]) for side in (left, right))
    readings["heading"] = heading_readings(SHEETS["heading"], *ends, rng)
    readings["joint"] = Readings(times["joint"], {"angle_rad": np.sin(times["joint"])})
    of_frame = ("lidar", "wheels", "doppler", "markers", "prism", "mast")
    readings |= {name: sampled(SHEETS[name], left[name], times[name], rng) for name in of_frame}
    readings["scanner"] = Readings(times["scanner"], {})
    return readings


HEALTHY = measure()


def able(fault_kind):
    """Return the sensors to which a fault can happen."""
    return tuple(name for name, one in SHEETS.items() if can_happen(fault_kind, one.kind))


def strike(kind, start_s=10.0, end_s=20.0, *, sensors=(), readings=HEALTHY, seed=0, **values):
    fault = Fault(kind=kind, sensors=sensors or able(kind)[:1], start_s=start_s, end_s=end_s, **values)
    return apply_faults([fault], readings, SHEETS, partial(generator, seed))


def within(readings, start_s=10.0, end_s=20.0):
    return (readings.times_s >= start_s) & (readings.times_s <= end_s)


def same(a, b):
    return a.times_s.tobytes() == b.times_s.tobytes() and all(
        a.values[name].tobytes() == b.values[name].tobytes() for name in a.values.keys() | b.values.keys()
    )


def moved_m(after, name="gnss"):
    return after[name].values["position"] - HEALTHY[name].values["position"]
