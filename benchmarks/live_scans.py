"""Prints what scans cost a live node, and how good its estimate is: `holdfast live` over DDS on simulated drives.

    holdfast simulate construction --scans --duration 120 -o site
    python benchmarks/live_scans.py site ...

Each folder is played at its own pace, its clouds as sensor_msgs/PointCloud2 from another process, once without scans
and once with them: what an IMU message takes to be answered, what a scan takes to become a pose (in time and processor
time), what was dropped, and how far the published track is from the truth. With `--ros PYTHON`, an interpreter that has
rclpy, the clouds come from a node of ROS 2 (`ros_clouds.py`); the tests keep such environments in the user's cache,
`tests/live/peer` has what is in them.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np
from dds import HOLDFAST, LOOPBACK, STAMP, beside, report
from ros_clouds import FRAME, stamped
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML

from holdfast.bench.replay import describe_machine
from holdfast.config.live import LiveConfig
from holdfast.evaluation.association import associate
from holdfast.live.dds import Network
from holdfast.live.idl import STORE
from holdfast.recording.tum import read_tum
from holdfast.state import Trajectory

CLOUD, IMU, ODOMETRY, DIAGNOSTICS = (
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Imu",
    "nav_msgs/msg/Odometry",
    "diagnostic_msgs/msg/DiagnosticArray",
)
WORLD = "/holdfast/odometry/world"


def configured(folder: Path, target: Path, domain: int, *, scans: bool, topic: str) -> None:
    """Write the configuration of a folder with its odometry made of scans, or without any."""
    content: dict[str, Any] = YAML(typ="safe").load((folder / "config.yaml").read_text())
    lidars = [name for name, sensor in content["sensors"].items() if sensor["kind"] == "odometry"]
    for name in lidars:
        if scans:
            content["sensors"][name] |= {"kind": "scans", "topic": topic}
        else:
            del content["sensors"][name]
    target.write_text(json.dumps(content | {"live": LOOPBACK | {"domain_id": domain}}))


def clouds(folder: Path, seconds: float) -> Iterator[tuple[float, str, bytes]]:
    """Yield the clouds of a recording: when after its beginning [s], topic, CDR."""
    with AnyReader([folder / "recording.mcap"]) as reader:
        for connection, at_ns, raw in reader.messages([c for c in reader.connections if c.msgtype == CLOUD]):
            if (at_s := (at_ns - reader.start_time) * 1e-9) > seconds:
                return
            yield at_s, connection.topic, raw


def play_clouds(folder: Path, domain: int, seconds: float, began: float, shift_ns: int) -> None:
    """Play the clouds of a recording as the driver of a lidar would, in a process of its own."""
    network = Network(LiveConfig(domain_id=domain, **LOOPBACK))
    publish: dict[str, Callable[[bytes], None]] = {}
    for at_s, topic, raw in clouds(folder, seconds):
        data = stamped(raw, shift_ns)
        if topic not in publish:
            publish[topic] = network.advertise(topic, CLOUD, depth=2)
        time.sleep(max(0.0, began + at_s - time.perf_counter()))
        publish[topic](data)
    time.sleep(1.0)
    network.close()


def write_clouds(folder: Path, file: Path, seconds: float, topic: str) -> None:
    """Write the clouds of a topic for a node that reads no bags."""
    with file.open("wb") as out:
        for at_s, of, raw in clouds(folder, seconds):
            if of == topic:
                out.write(FRAME.pack(at_s, len(raw)) + raw)


def play_clouds_in_ros(python: Path, file: Path, topic: str, *, domain: int, began: float, shift_ns: int) -> None:
    """The same by a node of ROS 2, in its own environment."""
    environment = {"PATH": os.environ["PATH"], "HOME": str(file.parent), "ROS_DOMAIN_ID": str(domain)}
    subprocess.Popen(
        [python, Path(__file__).with_name("ros_clouds.py"), file, topic, repr(began), str(shift_ns)],
        env=environment | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(file.parent)},
    )


def play(
    folder: Path, domain: int, seconds: float, start_clouds: Callable[[float, int], object] | None
) -> tuple[list[float], int, int, dict[str, str]]:
    """Play a recording as its drivers would.

    Args:
        start_clouds: begins to play the clouds, given the beginning [s] and what is added to stamps [ns].

    Returns round trips of the IMU [ms], how many had none, what was added to stamps [ns], and diagnostics.
    """
    network = Network(LiveConfig(domain_id=domain, **LOOPBACK))
    network.subscribe(WORLD, ODOMETRY, reliable=True)
    network.subscribe("/diagnostics", DIAGNOSTICS, reliable=True)
    sent: dict[bytes, float] = {}
    took: list[float] = []
    diagnostics: dict[str, str] = {}

    def receive(until: float) -> None:
        while (left := until - time.perf_counter()) > 0.0:
            for sample in network.wait(min(left, 0.05)):
                if sample.topic == WORLD:
                    at = sent.pop(sample.data[4 : 4 + STAMP.size], None)
                    if at is not None:
                        took.append((time.perf_counter() - at) * 1e3)
                    continue
                for status in STORE.deserialize_cdr(sample.data, sample.type_name).status:
                    if "odometry of" in status.name:
                        diagnostics.update({entry.key: entry.value for entry in status.values})

    with AnyReader([folder / "recording.mcap"]) as reader:
        left_out = ("/tf_static", "/tf", "/lidar/odometry")
        wanted = [c for c in reader.connections if c.topic not in left_out and c.msgtype != CLOUD]
        publish = {c.topic: network.advertise(c.topic, c.msgtype) for c in wanted}
        first_ns, count = reader.start_time, 0
        began = time.perf_counter() + 4.0
        shift_ns = time.time_ns() + 4 * 10**9 - first_ns
        if start_clouds is not None:
            start_clouds(began, shift_ns)
        for connection, at_ns, raw in reader.messages(wanted):
            at_s = (at_ns - first_ns) * 1e-9
            if at_s > seconds:
                break
            receive(began + at_s)
            data = stamped(raw, shift_ns)
            if connection.topic == "/imu/data":
                sent[data[4 : 4 + STAMP.size]] = time.perf_counter()
                count += 1
            publish[connection.topic](data)
        receive(time.perf_counter() + 1.5)
    network.close()
    return took[len(took) // 10 :], count - len(took), shift_ns, diagnostics


def measure(folder: Path, work: Path, domain: int, options: argparse.Namespace, *, scans: bool) -> dict[str, Any]:
    config, log, seconds, topic = work / "live.json", work / "log.mcap", options.seconds, options.topic

    def start_clouds(began: float, shift_ns: int) -> None:
        if options.ros is None:
            beside(play_clouds, folder, domain, seconds, began, shift_ns)
        else:
            play_clouds_in_ros(options.ros, work / "clouds", topic, domain=domain, began=began, shift_ns=shift_ns)

    if scans and options.ros is not None:
        write_clouds(folder, work / "clouds", seconds, topic)
    configured(folder, config, domain, scans=scans, topic=topic)
    arguments = ["live", "-c", str(config), "--record", str(log)]
    live = subprocess.Popen([sys.executable, "-c", HOLDFAST, *arguments], stderr=subprocess.PIPE, text=True)
    assert live.stderr is not None
    while "publishing" not in live.stderr.readline():
        if live.poll() is not None:
            sys.exit("holdfast live has ended")
    lines: list[str] = []
    Thread(target=lambda: lines.extend(live.stderr or ()), daemon=True).start()
    time.sleep(3.0)  # the odometry's process comes up
    took, unanswered, shift_ns, diagnostics = play(folder, domain, seconds, start_clouds if scans else None)
    live.send_signal(signal.SIGINT)
    live.wait(60)
    found = report(f"{folder.name}, {'with' if scans else 'without'} scans", took, unanswered)
    print(f"    {off_the_truth(folder, log, shift_ns)}")
    return found | {"diagnostics": diagnostics, "lines": lines}


def off_the_truth(folder: Path, log: Path, shift_ns: int) -> str:
    """Return how far the track that was published is from the truth, horizontally, once it has settled."""
    rows = []
    with AnyReader([log]) as reader:
        for connection, _, raw in reader.messages([c for c in reader.connections if c.topic == WORLD]):
            message = reader.deserialize(raw, connection.msgtype)
            p, q, stamp = message.pose.pose.position, message.pose.pose.orientation, message.header.stamp
            rows.append((stamp.sec * 10**9 + stamp.nanosec, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
    if len(rows) < 1000:
        return f"only {len(rows)} estimates"
    stamps_ns, positions, quaternions = zip(*rows[500:], strict=True)
    track = Trajectory(np.array(stamps_ns) - shift_ns, np.array(positions), np.array(quaternions))
    pairs = associate(read_tum(folder / "truth" / "imu_in_world.tum"), track)
    off_m = np.linalg.norm((pairs.estimate.positions - pairs.reference.positions)[:, :2], axis=1)
    return f"horizontal error: RMS {np.sqrt(np.mean(off_m**2)) * 1e3:.1f} mm, max {off_m.max() * 1e3:.1f} mm"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", help="written by holdfast simulate --scans")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each recording")
    parser.add_argument("--topic", default="/lidar/points")
    parser.add_argument("--ros", type=Path, metavar="PYTHON", help="interpreter with rclpy that publishes the clouds")
    options = parser.parse_args()
    domain = random.SystemRandom().randrange(1, 98)
    print(", ".join(f"{key} {value}" for key, value in describe_machine().items()))
    print(f"{'Imu in, Odometry out':34s} {'median':>7s} {'p95':>7s} {'p99':>7s} {'max':>7s}")
    for folder in options.folders:
        for number, scans in enumerate((False, True)):
            with TemporaryDirectory() as work:
                found = measure(folder, Path(work), domain + number, options, scans=scans)
            if scans:
                print("    " + ", ".join(f"{key} {value}" for key, value in found["diagnostics"].items()))
                print("".join(f"    live: {line}" for line in found["lines"][:12]), end="")


if __name__ == "__main__":
    main()
