"""The tree of frames as tf2 messages: what moves, at every estimate, and what is mounted, once."""

import gtsam

from holdfast.config.frame_tree import links_from
from holdfast.config.model import Config
from holdfast.messages import Array
from holdfast.ros.cdr import TransformEncoder
from holdfast.ros.outputs import quaternion_xyzw
from holdfast.state import BaseState, Estimate


class FrameTransforms:
    """The frames as REP-105 has them, `map -> odom -> base_link`, or the IMU instead of a base; each has one parent.

    The turn joint joins the cabin to the chassis, and `extrinsics` join what is mounted on either.
    """

    def __init__(self, config: Config) -> None:
        frames, joint = config.frames, config.turn_joint
        body = frames.base if config.has_base() else config.imu_frame
        self._has_base = config.has_base()
        self._joint = None if joint is None else gtsam.Pose3(joint.matrix())
        chain = [(frames.world, frames.odometry), (frames.odometry, body)]
        roots = [body]
        if joint is not None:
            chain.append((joint.parent, joint.child))
            roots.append(joint.child)
        self._chain, self._world = TransformEncoder(chain), TransformEncoder(chain[:1])
        self._mounts = [link for root in roots for link in links_from(root, config.links())]

    def mounts(self, stamp_ns: int) -> bytes:
        """Return the message for /tf_static: what does not move."""
        encoder = TransformEncoder([(parent, child) for parent, child, _ in self._mounts])
        return encoder.encode(stamp_ns, [translation_and_quaternion(gtsam.Pose3(T)) for _, _, T in self._mounts])

    def at(self, estimate: Estimate, base: BaseState | None) -> bytes:
        """Return the message for /tf; where the base is not known, nothing below `odom` is."""
        poses = [translation_and_quaternion(estimate.T_W_O)]
        if not self._has_base:
            poses.append(translation_and_quaternion(estimate.T_W_O.between(estimate.nav.pose())))
        elif base is None:
            return self._world.encode(estimate.stamp_ns, poses)
        else:
            poses.append(translation_and_quaternion(base.T_O_B))
            if self._joint is not None:
                rotation = gtsam.Rot3.Rz(base.joint_angle_rad) * self._joint.rotation()
                poses.append((self._joint.translation(), quaternion_xyzw(rotation)))
        return self._chain.encode(estimate.stamp_ns, poses)


def translation_and_quaternion(pose: gtsam.Pose3) -> tuple[Array, Array]:
    """Return the translation (3,) [m] and the quaternion (4,) x, y, z, w of a pose."""
    return pose.translation(), quaternion_xyzw(pose.rotation())
