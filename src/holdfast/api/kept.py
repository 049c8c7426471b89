"""What an estimator publishes, kept as arrays."""

from array import array

import numpy as np
from numpy.typing import NDArray

from holdfast.api.trajectory import Trajectory
from holdfast.evaluation import quaternions
from holdfast.geometry.rotations import quaternions_xyzw
from holdfast.messages import Array
from holdfast.ros.rows import Poses
from holdfast.smoothing.block import Block
from holdfast.state import CHASSIS, ESTIMATE, Output

WIDTH = ESTIMATE.itemsize // 8
CHASSIS_WIDTH = CHASSIS.itemsize // 8


class Kept:
    """Takes every output and every stretch of the optimum; a second of 100 Hz is 100 kB."""

    def __init__(self) -> None:
        self._stamps, self._values = array("q"), array("d")
        self._base_stamps, self._bases = array("q"), array("d")
        self._nodes: dict[int, tuple[Array, Array, Array]] = {}
        self._blocks: list[Block] = []

    def add(self, output: Output) -> None:
        """Take in the output of one message."""
        if output.estimate is not None:
            self._stamps.append(output.estimate.stamp_ns)
            self._values.frombytes(output.estimate.values[:WIDTH].tobytes())
        if output.base is not None:
            self._base_stamps.append(output.base.stamp_ns)
            self._bases.frombytes(output.base.values[WIDTH : WIDTH + CHASSIS_WIDTH].tobytes())
        poses = Poses.of(nav.pose() for _, nav in output.smoothed) if output.smoothed else None
        for k, (stamp_ns, nav) in enumerate(output.smoothed):
            assert poses is not None
            self._nodes[stamp_ns] = poses.translations[k], poses.quaternions[k], nav.velocity()

    def add_block(self, block: Block) -> None:
        """Take in a stretch of the optimum."""
        self._blocks.append(block)

    def world(self) -> Trajectory:
        """Return I in W, as it was published."""
        rows, later = self._rows()
        nav = rows["nav"]
        return Trajectory(later, nav["p"], rows["quaternion"], nav["v"], rows["covariance"])

    def odometry(self) -> Trajectory:
        """Return I in O: T_W_O^-1 T_W_I, which never jumps."""
        rows, later = self._rows()
        frame, nav = rows["T_W_O"], rows["nav"]
        back = np.swapaxes(frame["R"], 1, 2)
        positions = np.einsum("nij,nj->ni", back, nav["p"] - frame["p"])
        velocities = np.einsum("nij,nj->ni", back, nav["v"])
        q = quaternions.multiply(quaternions.conjugate(quaternions_xyzw(frame["R"])), rows["quaternion"])
        return Trajectory(later, positions, q, velocities, rows["covariance"])

    def base(self) -> Trajectory | None:
        """Return the chassis B in W, None where it is not known."""
        if not self._base_stamps:
            return None
        stamps = np.frombuffer(self._base_stamps, dtype=np.int64)
        later = _later(stamps)
        poses = np.frombuffer(self._bases, dtype=CHASSIS)[later]["T_W_B"]
        return Trajectory(stamps[later], poses["p"].copy(), quaternions_xyzw(poses["R"]))

    def smoothed(self) -> Trajectory | None:
        """Return the optimum if there is one, else the nodes as they left the window; None if there are none."""
        if self._blocks:
            return self._optimum()
        if not self._nodes:
            return None
        stamps = sorted(self._nodes)
        positions, turned, velocities = (np.array([self._nodes[one][k] for one in stamps]) for k in range(3))
        return Trajectory(np.array(stamps, dtype=np.int64), positions, turned, velocities)

    def _optimum(self) -> Trajectory:
        tracks = [block.track for block in self._blocks]
        stamps = np.concatenate([track.times_ns for track in tracks])
        later = _later(stamps)
        covariances = np.concatenate([block.covariances.at(block.track.times_ns) for block in self._blocks])
        return Trajectory(
            stamps[later],
            np.concatenate([track.positions for track in tracks])[later],
            np.concatenate([track.quaternions for track in tracks])[later],
            np.concatenate([track.velocities for track in tracks])[later],
            covariances[later],
        )

    def _rows(self) -> "tuple[NDArray[np.void], NDArray[np.int64]]":
        stamps = np.frombuffer(self._stamps, dtype=np.int64)
        later = _later(stamps)
        return np.frombuffer(self._values, dtype=ESTIMATE)[later], stamps[later]


def _later(stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which stamps (N,) are later than all before: a clock may go back."""
    later: NDArray[np.bool_] = np.diff(np.maximum.accumulate(stamps), prepend=np.iinfo(np.int64).min + 1) > 0
    if len(stamps):
        later[0] = True
    return later
