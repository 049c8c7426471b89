"""How exact the poses of a trajectory claim to be, and what that means for the points of a scan."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from holdfast.evaluation import quaternions
from holdfast.messages import Array
from holdfast.recording.covariance_csv import read_covariances
from holdfast.recording.raw import RawBag
from holdfast.replay.outputs import ESTIMATES
from holdfast.ros.messages import ODOMETRY
from holdfast.state import Trajectory

SMOOTHED = "imu_in_world.covariance.csv"
PERIOD_NS = 100_000_000  # of those that are kept of a replay: they change slowly


@dataclass(frozen=True, slots=True, eq=False)
class PoseCovariances:
    """Covariances of poses of I in W.

    Attributes:
        stamps_ns: (K,) increasing.
        values: (K, 6, 6) of position [m], then rotation [rad], about the axes of W, as in ROS.
    """

    stamps_ns: NDArray[np.int64]
    values: Array

    def sigmas(self, stamp_ns: int, levers: Array) -> Array:
        """Return the sigmas (N,) [m] of points that are fixed to I: the root of the three variances added.

        A point at rho beside I moves by dp + dphi x rho.

        Args:
            stamp_ns: the newest covariance before it holds.
            levers: (N, 3) rho, from I to the points, in the axes of W [m].
        """
        row = max(int(np.searchsorted(self.stamps_ns, stamp_ns, side="right")) - 1, 0)
        J = np.zeros((len(levers), 3, 6))
        J[:, [0, 1, 2], [0, 1, 2]] = 1.0
        x, y, z = levers.T
        J[:, 0, 4], J[:, 0, 5], J[:, 1, 3], J[:, 1, 5], J[:, 2, 3], J[:, 2, 4] = z, -y, -z, x, y, -x
        variances = np.einsum("nij,nij->n", J @ self.values[row], J)
        sigmas: Array = np.sqrt(np.maximum(variances, 0.0))
        return sigmas


def read_pose_covariances(folder: Path, trajectory: Trajectory) -> PoseCovariances | None:
    """Read what `holdfast smooth` or `holdfast replay` wrote beside imu_in_world.tum; None if there is nothing.

    Raises:
        RecordingError: a file is damaged.
    """
    if (folder / SMOOTHED).is_file():
        return _of_smooth(folder / SMOOTHED, trajectory)
    return _of_replay(folder / ESTIMATES) if (folder / ESTIMATES).is_file() else None


def _of_replay(file: Path) -> PoseCovariances | None:
    stamps: list[int] = []
    values: list[Array] = []
    with RawBag(file) as bag:
        codecs = {c: c.codec() for c in bag.channels if c.topic.endswith("/odometry/world") and c.type == ODOMETRY}
        for stamp_ns, channel, raw in bag.messages():
            if channel in codecs and (not stamps or stamp_ns >= stamps[-1] + PERIOD_NS):
                stamps.append(stamp_ns)
                values.append(np.reshape(codecs[channel].deserialize(raw).pose.covariance, (6, 6)))
    return PoseCovariances(np.array(stamps, dtype=np.int64), np.array(values)) if stamps else None


def _of_smooth(file: Path, trajectory: Trajectory) -> PoseCovariances:
    """Read covariances in the axes of I, and bring them to those of W."""
    found = read_covariances(file)
    stamps_ns, full = found.times_ns, found.values
    near = np.clip(np.searchsorted(trajectory.stamps_ns, stamps_ns), 0, len(trajectory.stamps_ns) - 1)
    q = trajectory.quaternions[near]
    R = np.stack([quaternions.rotate(q, axis) for axis in np.eye(3)], axis=-1)
    turned = np.zeros((len(full), 6, 6))
    blocks = (slice(3, 6), slice(0, 3))  # position, rotation
    for i, rows in enumerate(blocks):
        for j, columns in enumerate(blocks):
            block = R @ full[:, rows, columns] @ R.transpose(0, 2, 1)
            turned[:, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
    return PoseCovariances(stamps_ns, turned)
