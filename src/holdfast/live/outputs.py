"""What a live node publishes: odometry, transforms, the path, the datum, diagnostics and log."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from holdfast.config.model import Config
from holdfast.geometry.earth import Geodetic
from holdfast.live.dds import Network, Publish
from holdfast.live.feed import Record
from holdfast.live.idl import STORE
from holdfast.live.path import DrivenPath
from holdfast.ros.cdr import ros_time
from holdfast.ros.messages import (
    DIAGNOSTICS,
    TRANSFORMS,
    EstimateMessages,
    RosMessage,
    Status,
    diagnostic_array,
)
from holdfast.ros.rows import Rows, quaternion_xyzw
from holdfast.state import BaseState, Estimate

PATH = "nav_msgs/msg/Path"
FIX = "sensor_msgs/msg/NavSatFix"
LOG = "rcl_interfaces/msg/Log"
NO_COVARIANCE = np.zeros(9)


class Level(IntEnum):
    """Severity of a line of the log, numbered as in rcl_interfaces/Log."""

    INFO = 20
    WARN = 30
    ERROR = 40


class Outputs:
    """Publishes everything, and keeps what was published since the last `take_records`.

    Args:
        network: where to publish.
        config: names frames and topics.
        node: full name of the node, the `~` of its topics.
    """

    def __init__(self, network: Network, config: Config, node: str) -> None:
        self._node = node
        self._world_frame = config.frames.world
        self._with_tf = config.live.publish_tf
        self._messages = EstimateMessages(config, node)
        self._has_base = config.has_base()
        self._path = DrivenPath(config.frames.world, config.live.path_step_m)
        self._path_grew = False
        self._stamp_ns = 0
        self._mounted = not self._messages.has_mounts
        self._records: list[Record] = []
        topics = {topic: kind for topic, kind in self._messages.topics.items() if self._with_tf or topic != "/tf"}
        self._publish: dict[str, Publish] = {topic: network.advertise(topic, kind) for topic, kind in topics.items()}
        self._publish[f"{node}/path"] = network.advertise(f"{node}/path", PATH, depth=1)
        self._publish[f"{node}/datum"] = network.advertise(f"{node}/datum", FIX, latched=True, depth=1)
        self._publish["/diagnostics"] = network.advertise("/diagnostics", DIAGNOSTICS)
        self._publish["/rosout"] = network.advertise("/rosout", LOG, latched=True)
        if self._with_tf:
            self._publish["/tf_static"] = network.advertise("/tf_static", TRANSFORMS, latched=True, depth=1)

    @property
    def topics(self) -> list[str]:
        """Return the topics that are published."""
        return list(self._publish)

    def estimate(self, estimate: Estimate, base: BaseState | None, now_ns: int) -> None:
        """Publish an estimate, stamped as the IMU sample that it belongs to."""
        if self._with_tf and not self._mounted:
            self._mounted = True
            self._send(self._messages.mounts(estimate.stamp_ns), now_ns)
        rows = Rows.of([estimate], [] if base is None else [base])
        for message in self._messages.of(rows)[0]:
            if message.topic in self._publish:
                self._send(message, now_ns)
        self._stamp_ns = estimate.stamp_ns
        pose = estimate.nav.pose() if not self._has_base else base.T_W_B if base is not None else None
        if pose is not None:
            self._path_grew |= self._path.add(estimate.stamp_ns, pose.translation(), quaternion_xyzw(pose.rotation()))

    def path(self, now_ns: int) -> None:
        """Publish the path if it has grown since the last time."""
        if self._path_grew:
            self._path_grew = False
            self._send(RosMessage(f"{self._node}/path", PATH, self._path.encode(self._stamp_ns)), now_ns)

    def clear_path(self) -> None:
        """Begin the path anew."""
        self._path.clear()
        self._path_grew = False

    def datum(self, datum: Geodetic, now_ns: int) -> None:
        """Publish the origin of the world frame; a later subscriber gets it, too."""
        types = STORE.types
        message = types[FIX](
            header=self._header(now_ns, self._world_frame),
            status=types["sensor_msgs/msg/NavSatStatus"](status=0, service=0),
            latitude=datum.latitude_deg,
            longitude=datum.longitude_deg,
            altitude=datum.altitude_m,
            position_covariance=NO_COVARIANCE,
            position_covariance_type=0,
        )
        self._send(self._encoded(f"{self._node}/datum", message, FIX), now_ns)

    def diagnostics(self, statuses: Sequence[Status], now_ns: int) -> None:
        """Publish diagnostics."""
        message = diagnostic_array(STORE.types, now_ns, statuses)
        self._send(self._encoded("/diagnostics", message, DIAGNOSTICS), now_ns)

    def log(self, level: Level, text: str, now_ns: int) -> None:
        """Publish a line of the log on /rosout."""
        message = STORE.types[LOG](
            stamp=self._time(now_ns), level=level, name=self._node.removeprefix("/").replace("/", "."), msg=text,
            file="", function="", line=0,
        )  # fmt: skip
        self._send(self._encoded("/rosout", message, LOG), now_ns)

    def take_records(self) -> list[Record]:
        """Return what was published since the last call."""
        records, self._records = self._records, []
        return records

    def _send(self, message: RosMessage, now_ns: int) -> None:
        self._publish[message.topic](message.data)
        self._records.append(Record(*message, now_ns))

    def _encoded(self, topic: str, message: object, type_name: str) -> RosMessage:
        return RosMessage(topic, type_name, bytes(STORE.serialize_cdr(message, type_name)))

    def _header(self, stamp_ns: int, frame_id: str) -> Any:
        return STORE.types["std_msgs/msg/Header"](stamp=self._time(stamp_ns), frame_id=frame_id)

    def _time(self, stamp_ns: int) -> Any:
        return STORE.types["builtin_interfaces/msg/Time"](*ros_time(stamp_ns))
