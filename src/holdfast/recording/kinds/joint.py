"""Angles of the turn joint."""

from collections.abc import Sequence
from math import isfinite

from holdfast.config.assignment import Rule
from holdfast.errors import RecordingError
from holdfast.messages import JointAngle
from holdfast.printable import listed
from holdfast.recording.columns import Columns
from holdfast.recording.decode import STAMP, Decoder, FieldDecoder, UndecodableError
from holdfast.recording.kinds import Kind, register
from holdfast.recording.source import Subscription

JOINT_STATE = "sensor_msgs/msg/JointState"


def joint_decoder(subscription: Subscription) -> Decoder:
    """Decode one joint of sensor_msgs/JointState.

    The decoder raises RecordingError if the message has several joints and the subscription does not name one.
    """
    wanted = subscription.joint_name

    def build(arrival_ns: int, sec: int, nanosec: int, names: Sequence[str], angles: Sequence[float]) -> JointAngle:
        if wanted is None:
            if len(names) > 1:
                raise RecordingError(f"{subscription.topic}: set joint_name to one of {listed(list(names))}")
            index = 0
        elif wanted in names:
            index = names.index(wanted)
        else:
            raise UndecodableError(f"joint {wanted!r} is not among {listed(list(names)) or 'the joints (none)'}")
        if index >= len(angles) or not isfinite(angles[index]):
            raise UndecodableError("the joint has no finite position")
        return JointAngle(sec * 1_000_000_000 + nanosec, arrival_ns, subscription.sensor, float(angles[index]))

    return FieldDecoder((*STAMP, "name", "position"), build)


def _of_line(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> JointAngle:
    if not isfinite(v[0]):
        raise UndecodableError("angle is not finite")
    return JointAngle(stamp_ns, arrival_ns, sensor, v[0])


register(
    Kind(
        "joint",
        JointAngle,
        {JOINT_STATE: joint_decoder},
        Columns(("angle_rad",), _of_line),
        rules=(Rule("joint", ("turn", "swing", "slew", "cabin", "joint_states")),),
        gap="the base state is interpolated over it",
        needs_config=True,  # a JointState may have several joints
        rank=80,
    )
)
