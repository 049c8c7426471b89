"""A short recording with clouds, and the command that makes poses of them."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from bags import HUMBLE, NOETIC, imu
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg
from yard import START_NS, message, sweep

from holdfast.cli.lidar_odometry import lidar_odometry

DELAY_NS = 212_000_000
SWEEPS = 7
THING = "site_msgs/msg/Thing"
for store in (HUMBLE, NOETIC):
    store.register(get_types_from_msg("std_msgs/Header header\nfloat64 load\nstring[] who\n", THING))


def turning(t):
    return 0.1 * np.asarray(t)


@cache
def sweeps():
    rng = np.random.default_rng(3)
    return [sweep(k, rng, turning) for k in range(SWEEPS)]


def messages(store, more=(), number=SWEEPS):
    """(topic, arrival, message) of a short recording: clouds, an IMU and something that no standard knows."""
    rows = list(more)
    for k in range(number):
        swept = replace(sweeps()[k % SWEEPS], stamp_ns=START_NS + k * 200_000_000)
        rows.append(("/points", swept.stamp_ns + DELAY_NS, message(store, swept)))
    for k in range(number * 20):
        stamp_ns = START_NS + k * 10_000_000
        rows.append(("/imu", stamp_ns + 1_000_000, imu(store, stamp_ns, rate=(0.0, 0.0, 0.1))))
    header = imu(store, START_NS).header
    rows.append(("/things", START_NS + 500_000_000, store.types[THING](header, 1250.5, ["left", "right"])))
    return sorted(rows, key=lambda row: row[1])


def convert(bag, out, *options):
    """Run the command in this process."""
    lidar_odometry.main([str(bag), "-o", str(out), *map(str, options)], standalone_mode=False)
    return out


def read(path, topic=None):
    """(topic, arrival, message) rows of a bag, in its own order."""
    with AnyReader([Path(path)]) as reader:
        connections = [c for c in reader.connections if topic in (None, c.topic)]
        return [(c.topic, at, reader.deserialize(raw, c.msgtype)) for c, at, raw in reader.messages(connections)]
