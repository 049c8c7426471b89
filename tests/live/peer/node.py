"""A node of a real ROS 2: plays messages, hears what Holdfast publishes, and writes it down field by field.

Runs in an environment of its own that has rclpy and nothing of Holdfast: `node.py TASK.json OUT.json`.

TASK: {"play": [[time_s, topic, type, CDR in hex], ...], "receive": [[topic, type, latched], ...], "linger_s": number,
"then": [[topic, type, fields], ...]}. It begins once everybody has met; the first stamp becomes the present time.
"""

import json
import sys
import time
from importlib import import_module
from pathlib import Path

import rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy, qos_profile_sensor_data
from rclpy.serialization import deserialize_message


def message_class(name):
    package, _, bare = name.split("/")
    return getattr(import_module(f"{package}.msg"), bare)


def fields(value):
    """A message as plain values; numbers keep every bit in JSON."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: fields(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, str | int | float):
        return value
    return [fields(entry) for entry in value]


class Peer:
    def __init__(self, task):
        self.task = task
        self.sent = {}
        self.received = {topic: [] for topic, _, _ in task["receive"]}
        self.node = rclpy.create_node("peer")
        for topic, name, latched in task["receive"]:
            qos = QoSProfile(depth=5000)  # reliable and volatile, as ROS users have it
            if latched:
                qos = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
            self.node.create_subscription(
                message_class(name), topic, lambda message, of=topic: self.received[of].append(fields(message)), qos
            )
        topics = {topic: name for _, topic, name, _ in task["play"]}
        self.publishers = {
            topic: self.node.create_publisher(message_class(name), topic, qos_profile_sensor_data)
            for topic, name in topics.items()
        }
        reliable = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.RELIABLE)
        self.controls = {
            topic: self.node.create_publisher(message_class(name), topic, reliable)
            for topic, name, _ in task.get("then", [])
        }

    def spin_until(self, done, timeout_s):
        end = time.monotonic() + timeout_s
        while not done() and time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.02)
        return done()

    def listen_until_silence(self, linger_s):
        """Take in what is still on its way, until for so long only diagnostics have come."""
        before = None
        while before != (before := sum(len(got) for topic, got in self.received.items() if topic != "/diagnostics")):
            self.spin_until(lambda: False, linger_s)

    def run(self):
        everyone = [*self.publishers.values(), *self.controls.values()]
        met = self.spin_until(lambda: all(p.get_subscription_count() for p in everyone), 30.0)
        is_published = self.spin_until(lambda: all(self.node.count_publishers(topic) for topic in self.received), 30.0)
        if not met or not is_published:
            missing = [p.topic_name for p in everyone if not p.get_subscription_count()]
            sys.exit(f"no match: {missing}, {[t for t in self.received if not self.node.count_publishers(t)]}")
        began, offset_ns = time.monotonic(), None
        for at_s, topic, name, data in self.task["play"]:
            while time.monotonic() < began + at_s:
                rclpy.spin_once(self.node, timeout_sec=max(0.0, min(0.002, began + at_s - time.monotonic())))
            message = deserialize_message(bytes.fromhex(data), message_class(name))
            stamp = message.header.stamp
            if offset_ns is None:
                offset_ns = time.time_ns() - stamp.sec * 10**9 - stamp.nanosec
            shifted_ns = stamp.sec * 10**9 + stamp.nanosec + offset_ns
            stamp.sec, stamp.nanosec = divmod(shifted_ns, 10**9)
            self.publishers[topic].publish(message)
            self.sent.setdefault(topic, []).append(fields(message))
        self.offset_ns = offset_ns
        for topic, name, values in self.task.get("then", []):
            message = message_class(name)()
            for field, value in values.items():
                setattr(message, field, value)
            self.controls[topic].publish(message)
        self.listen_until_silence(self.task["linger_s"])


def main(task_path, out_path):
    task = json.loads(Path(task_path).read_text())
    rclpy.init()
    peer = Peer(task)
    peer.run()
    names = dict(peer.node.get_topic_names_and_types())
    found = {"received": peer.received, "sent": peer.sent, "offset_ns": peer.offset_ns, "topics": names}
    Path(out_path).write_text(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
