"""Finds how an odometry is mounted from how it and the machine moved, however wrong the configuration is.

A sensor that is turned sees every motion turned: its rotations about other axes, its ways in other directions. Two of
these that are not parallel tell by how much (hand-eye calibration with a known lever arm): (87) in docs/math.md.
"""

from collections.abc import Sequence

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.sensors.odometry_calibration import FOUND_RAD

ROTATION_RAD, TRANSLATION_M = 0.01, 0.1  # sigmas of a motion of about a second


def found_mount(moved: Sequence[gtsam.Pose3], measured: Sequence[gtsam.Pose3]) -> Array | None:
    """Return the rotation vector (3,) by which a sensor is turned, in its own axes [rad]; None where nothing tells.

    Args:
        moved: motions of the machine from one time to the next, of the sensor as it is configured.
        measured: the same motions as the sensor measured them.
    """
    told, turned = np.zeros((3, 3)), np.zeros((3, 3))
    for true, seen in zip(moved, measured, strict=True):
        for e, z in zip(_vectors(true), _vectors(seen), strict=True):
            told += z @ z * np.eye(3) - np.outer(z, z)
            turned += np.outer(e, z)
    if np.linalg.eigvalsh(told)[0] < FOUND_RAD**-2:
        return None
    delta: Array = gtsam.Rot3.Logmap(gtsam.Rot3(gtsam.SO3.ClosestTo(turned).matrix()))
    return delta


def _vectors(motion: gtsam.Pose3) -> tuple[Array, Array]:
    """Return the rotation vector (3,) of a motion and its way (3,), each over its sigma."""
    return gtsam.Rot3.Logmap(motion.rotation()) / ROTATION_RAD, motion.translation() / TRANSLATION_M
