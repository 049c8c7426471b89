"""The tree of frames as tf2 messages: what moves, at every estimate, and what is mounted, once."""

import gtsam

from holdfast.config.frame_tree import links_from
from holdfast.config.model import Config
from holdfast.geometry.rotations import about_z, quaternions_xyzw
from holdfast.ros.cdr import TransformEncoder
from holdfast.ros.rows import Poses, Rows


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
        poses = Poses.of(gtsam.Pose3(T) for _, _, T in self._mounts)
        return encoder.encode([stamp_ns], list(zip(poses.translations, poses.quaternions, strict=True)))[0]

    def at(self, rows: Rows) -> list[bytes]:
        """Return the messages for /tf; where the base is not known, nothing below `odom` is."""
        poses = [rows.T_W_O[:2]]
        if self._has_base and not len(rows.chassis):
            return self._world.encode(rows.stamps_ns, poses)
        if self._has_base:
            poses.append(rows.T_O_B[:2])
            if self._joint is not None:
                turned = about_z(rows.chassis["joint_angle_rad"]) @ self._joint.rotation().matrix()
                poses.append((self._joint.translation(), quaternions_xyzw(turned)))
        else:
            poses.append(rows.T_O_I[:2])
        return self._chain.encode(rows.stamps_ns, poses)
