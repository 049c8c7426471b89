"""Reads of a bag what it tells of frames: transforms, frames of the sensors' messages, names of joints.

A transform on `/tf` counts as rigid where it stays the same all the while; one that follows the angle of a joint is
kept as it is where that joint reads zero.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np

from holdfast.config.recorded_frames import (
    RecordedFrames,
    RecordedLink,
    faultless,
    is_fixed_to_earth,
    rotation_angle_deg,
)
from holdfast.errors import RecordingError
from holdfast.messages import Array
from holdfast.recording.bag_file import Codec
from holdfast.recording.decode import IMU, ODOMETRY, TWIST, TWIST_COVARIANCE, UndecodableError, normalised
from holdfast.recording.kinds.gnss import FIX
from holdfast.recording.kinds.joint import JOINT_STATE
from holdfast.recording.raw import RawBag, RawChannel
from holdfast.recording.source import Recording

TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
SAME_M, SAME_DEG = 1e-3, 0.1  # what a transform that does not move may differ by
FOLLOWS_DEG = 0.5  # what one that follows a joint may differ by: their stamps are not the same
MIN_SEEN = 2  # a transform that is told once on /tf may move for all that is known
IN_HEADER = (IMU, FIX, TWIST, TWIST_COVARIANCE)  # types whose header names the frame of the sensor


@dataclass(slots=True)
class _Seen:
    """All poses of one frame in its parent on one topic: stamps [ns] and T (4, 4) [m]."""

    static: bool
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)


def read_frames(recording: Recording, duration_s: float) -> RecordedFrames:
    """Return what a recording tells of frames; nothing where it is no bag.

    Args:
        recording: whose path is opened once more.
        duration_s: how much of moving transforms, and of joints, is read; static ones may come later.
    """
    types = {topic.topic: topic.type for topic in recording.topics}
    try:
        bag = RawBag(recording.path)
    except RecordingError:  # no bag
        return RecordedFrames()
    with bag:
        end_ns = None if recording.start_ns is None else recording.start_ns + round(duration_s * 1e9)
        static = {topic for topic, name in types.items() if name in TRANSFORMS and topic.endswith("tf_static")}
        moving = {topic for topic, name in types.items() if name in (*TRANSFORMS, JOINT_STATE)} - static
        seen: dict[tuple[str, str, str], _Seen] = {}
        angles: dict[str, dict[str, list[tuple[int, float]]]] = {}
        broken: dict[str, str] = {}
        for channel, message in (*_decoded(bag, static, None), *_decoded(bag, moving, end_ns)):
            try:
                if channel.type == JOINT_STATE:
                    _note_joints(angles.setdefault(channel.topic, {}), message)
                else:
                    broken |= _note_transforms(seen, message, channel.topic, channel.topic in static)
            except (AttributeError, TypeError, ValueError):
                broken[channel.topic] = f"{channel.topic}: the file defines {channel.type} otherwise than ROS does"
        framed = {topic for topic, name in types.items() if name in (*IN_HEADER, ODOMETRY)}
        of_topic = {topic: frame for topic, frame in _frames_of(bag, framed) if not is_fixed_to_earth(frame)}
    rigid, turning = _sorted(seen, angles)
    links, warnings = faultless(rigid)
    return RecordedFrames(
        links=tuple(links),
        turning=tuple(turning),
        of_topic=of_topic,
        joints={topic: tuple(names) for topic, names in angles.items()},
        warnings=(*warnings, *broken.values()),
    )


def _decoded(bag: RawBag, topics: Iterable[str], end_ns: int | None) -> Iterator[tuple[RawChannel, Any]]:
    """Yield the messages of some topics; those that cannot be decoded, and what comes after damage, are left out."""
    codecs: dict[RawChannel, Codec] = {}
    try:
        for _, channel, raw in bag.messages(set(topics), end_ns):
            try:
                codec = codecs.get(channel) or codecs.setdefault(channel, channel.codec())
                yield channel, codec.deserialize(raw)
            except Exception:  # a replay counts what cannot be decoded
                continue
    except RecordingError:  # whoever reads the measurements reports the damage
        return


def _frames_of(bag: RawBag, topics: set[str]) -> Iterator[tuple[str, str]]:
    """Yield the frame in which each topic's first message measures, if it names one."""
    for topic in sorted(topics):
        for channel, message in _decoded(bag, {topic}, None):
            with suppress(AttributeError, TypeError):  # the file defines the type otherwise than ROS does
                frame = message.child_frame_id if channel.type == ODOMETRY else message.header.frame_id
                if frame.strip("/"):
                    yield topic, frame.strip("/")
            break


def _note_joints(angles: dict[str, list[tuple[int, float]]], message: Any) -> None:
    stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    for name, angle in zip(message.name, message.position, strict=False):
        if isfinite(angle):
            angles.setdefault(name, []).append((stamp_ns, float(angle)))


def _note_transforms(
    seen: dict[tuple[str, str, str], _Seen], message: Any, topic: str, static: bool
) -> Mapping[str, str]:
    """Take in one message, and return what was wrong with its transforms, by frame."""
    broken = {}
    for stamped in message.transforms:
        parent, child = stamped.header.frame_id.strip("/"), stamped.child_frame_id.strip("/")
        if is_fixed_to_earth(parent) or is_fixed_to_earth(child) or not parent or not child:
            continue
        try:
            T = _pose(stamped.transform)
        except UndecodableError as error:
            broken[child] = f"{topic}: {child!r} in {parent!r} is not used: {error}"
            continue
        stamp_ns = stamped.header.stamp.sec * 1_000_000_000 + stamped.header.stamp.nanosec
        of_link = seen.setdefault((parent, child, topic), _Seen(static))
        of_link.stamps_ns.append(stamp_ns)
        of_link.poses.append(T)
    return broken


def _pose(transform: Any) -> Array:
    """Return a geometry_msgs/Transform as a (4, 4) matrix [m].

    Raises:
        UndecodableError: it is not finite, or its quaternion is none.
    """
    t, q = transform.translation, transform.rotation
    T = np.eye(4)
    T[:3, 3] = t.x, t.y, t.z
    if not np.isfinite(T).all():
        raise UndecodableError("its translation is not finite")
    T[:3, :3] = _rotation(normalised(np.array((q.x, q.y, q.z, q.w))))
    return T


def _rotation(q: Array) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,) x, y, z, w."""
    v, w = q[:3], q[3]
    skew = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    R: Array = np.eye(3) + 2.0 * w * skew + 2.0 * skew @ skew
    return R


def _sorted(
    seen: Mapping[tuple[str, str, str], _Seen], angles: Mapping[str, Mapping[str, list[tuple[int, float]]]]
) -> tuple[list[RecordedLink], list[RecordedLink]]:
    """Return the transforms that are rigid, and those that follow a joint, at its zero.

    Where a joint stood still nobody can tell a transform that follows it from one that is rigid: beside a joint that
    did not move, a transform on /tf counts as one that follows it, because rigid ones belong on /tf_static.
    """
    rigid, turning = [], []
    joints = [
        (name, np.array(readings, dtype=object)) for of in angles.values() for name, readings in of.items() if readings
    ]
    for (parent, child, topic), of_link in seen.items():
        if of_link.static:
            rigid += [RecordedLink(parent, child, T, topic) for T in of_link.poses]
            continue
        for name, readings in joints:
            T = _at_zero(of_link, readings)
            if T is not None:
                turning.append(RecordedLink(parent, child, T, f"from {topic}, turned back by the angle of {name}"))
                break
        else:
            if len(of_link.poses) >= MIN_SEEN and _stays(of_link.poses, SAME_DEG):
                rigid.append(RecordedLink(parent, child, of_link.poses[0], f"{topic} (constant there)"))
    return rigid, turning


def _at_zero(of_link: _Seen, readings: Any) -> Array | None:
    """Return the pose T_parent_child (4, 4) [m] where the joint reads zero; None where it does not follow the joint.

    T(angle) = T(0) with its rotation turned by the angle about the parent's z axis.
    """
    stamps_ns, angles = readings[:, 0].astype(np.int64), readings[:, 1].astype(np.float64)
    order = np.argsort(stamps_ns, kind="stable")
    at = np.interp(np.array(of_link.stamps_ns), stamps_ns[order], angles[order])
    back = []
    for T, angle in zip(of_link.poses, at, strict=True):
        turned = np.eye(4)
        c, s = np.cos(-angle), np.sin(-angle)
        turned[:2, :2] = [[c, -s], [s, c]]
        zero = T.copy()
        zero[:3, :3] = turned[:3, :3] @ T[:3, :3]
        back.append(zero)
    return back[0] if _stays(back, FOLLOWS_DEG) else None


def _stays(poses: list[Array], within_deg: float) -> bool:
    first = poses[0]
    return all(
        float(np.linalg.norm(T[:3, 3] - first[:3, 3])) <= SAME_M
        and rotation_angle_deg(first[:3, :3].T @ T[:3, :3]) <= within_deg
        for T in poses
    )
