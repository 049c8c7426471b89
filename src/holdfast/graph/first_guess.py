"""Where the search for a start in motion begins: track, velocities and attitudes from GNSS and IMU alone."""

from collections.abc import Sequence

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.sensors.sensor import Position, Velocity

FASTEST_M_S = 30.0  # no machine is faster; a velocity that may be off by more says nothing


def course(stamps: Sequence[int], positions: Sequence[Position], velocities: Sequence[Velocity]) -> tuple[Array, Array]:
    """Return position and velocity (N, 3) at some times, interpolated; velocities from positions if there are none."""
    t = _seconds(stamps, stamps[0])
    track = _interpolate(t, _seconds([one.stamp_ns for one in positions], stamps[0]), [one.p_W_P for one in positions])
    measured = [one for one in velocities if one.covariance.diagonal().max() < FASTEST_M_S**2]
    if len(measured) < 2:
        return track, np.gradient(track, t, axis=0)
    at = _seconds([one.stamp_ns for one in measured], stamps[0])
    return track, _interpolate(t, at, [one.v_W_P for one in measured])


def _seconds(stamps: Sequence[int], origin_ns: int) -> Array:
    return np.array([stamp - origin_ns for stamp in stamps]) * 1e-9


def _interpolate(at: Array, times: Array, values: Sequence[Array]) -> Array:
    rows = np.array(values)
    return np.column_stack([np.interp(at, times, rows[:, axis]) for axis in range(3)])


def first_attitudes(
    stamps: Sequence[int], deltas: Sequence[gtsam.PreintegratedImuMeasurements], speeds: Array, gravity: float
) -> tuple[gtsam.Rot3, list[gtsam.Rot3]]:
    """Return R_W_I at the first node, and the attitudes at all nodes relative to it, by the gyroscope.

    The specific force that was integrated between nodes, turned into I at the first, must be the change of velocity
    without gravity: the rotation between these two sets of vectors.
    """
    attitudes = [gtsam.Rot3()]
    sensed = []
    for pim in deltas:
        sensed.append(attitudes[-1].rotate(pim.deltaVij()))
        attitudes.append(attitudes[-1].compose(pim.deltaRij()))
    expected = np.diff(speeds, axis=0)
    expected[:, 2] += gravity * np.diff(_seconds(stamps, stamps[0]))
    return gtsam.Rot3.ClosestTo(expected.T @ np.array(sensed)), attitudes


def level_attitude(specific_force: Array) -> gtsam.Rot3:
    """Return the attitude R_W_I with zero heading that puts the specific force (3,) upright."""
    fx, fy, fz = specific_force
    roll = np.arctan2(fy, fz)
    pitch = np.arctan2(-fx, np.hypot(fy, fz))
    return gtsam.Rot3.RzRyRx(roll, pitch, 0.0)
