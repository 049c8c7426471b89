"""Prints what the network costs: an Imu goes in over DDS, an Odometry comes back, between processes on loopback.

`python benchmarks/dds.py` measures in one run, each at 100, 200 and 400 Hz: a socket that answers with as many bytes
(the floor), DDS that answers with an Odometry at once (the transport), and `holdfast live` on a simulated drive at its
own 100 Hz, which decodes, estimates, encodes and publishes meanwhile. `--flood 4000` measures `holdfast live` alone,
first as it is, then while one antenna publishes 4000 fixes a second.
"""

import argparse
import json
import random
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML

from holdfast.bench.replay import describe_machine
from holdfast.config.live import LiveConfig
from holdfast.live.dds import Network
from holdfast.live.idl import STORE
from holdfast.ros.cdr import OdometryEncoder

IMU, FIX, ODOMETRY = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix", "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
LOOPBACK: dict[str, Any] = {"interface": "lo", "multicast": False, "peers": ["localhost"]}
STAMP = struct.Struct("<iI")  # behind the four bytes of the encapsulation
ODOMETRY_BYTES = 720
HOLDFAST = "from holdfast.cli import main; main()"
WARM_UP_FRACTION = 0.1  # of the answers is left out
IDENTITY = np.eye(6).ravel()

Row = tuple[float, str, str, Any]


def join(domain: int) -> Network:
    return Network(LiveConfig(domain_id=domain, **LOOPBACK))


def echo_datagrams(port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", port))
        rest = bytes(ODOMETRY_BYTES - STAMP.size - 4)
        while True:
            data, sender = server.recvfrom(2048)
            server.sendto(data[: 4 + STAMP.size] + rest, sender)


def echo_odometry(domain: int) -> None:
    network = join(domain)
    network.subscribe("/imu/data", IMU)
    publish = network.advertise("/odometry", ODOMETRY)
    encoder, zero = OdometryEncoder("map", "imu"), np.zeros(3)
    while True:
        for sample in network.wait(1.0):
            sec, nanosec = STAMP.unpack_from(sample.data, 4)
            stamp_ns = sec * 10**9 + nanosec
            publish(encoder.encode(stamp_ns, zero, [0.0, 0.0, 0.0, 1.0], IDENTITY, zero, zero, IDENTITY))


class OverDatagrams:
    """The other end of a socket."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))

    def send(self, _: str, data: bytes) -> None:
        self._socket.send(data)

    def wait(self, timeout_s: float) -> list[bytes]:
        self._socket.settimeout(max(timeout_s, 1e-4))
        try:
            return [self._socket.recv(2048)]
        except (TimeoutError, ConnectionRefusedError):
            return []


class OverDds:
    """A machine on the network that receives one topic."""

    def __init__(self, domain: int, topics: dict[str, str], answer: str) -> None:
        self._network = join(domain)
        self._network.subscribe(answer, ODOMETRY, reliable=True)
        self._publish = {topic: self._network.advertise(topic, name) for topic, name in topics.items()}

    def send(self, topic: str, data: bytes) -> None:
        self._publish[topic](data)

    def wait(self, timeout_s: float) -> list[bytes]:
        return [sample.data for sample in self._network.wait(timeout_s)]


def at_rate(rate_hz: float, seconds: float) -> Iterator[tuple[float, str, bytes]]:
    types, nine = STORE.types, np.zeros(9)
    stamp, zero = types["builtin_interfaces/msg/Time"](0, 0), types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    header, upright = (
        types["std_msgs/msg/Header"](stamp, "imu"),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    data = bytearray(STORE.serialize_cdr(types[IMU](header, upright, nine, zero, nine, zero, nine), IMU))
    for k in range(round(rate_hz * seconds)):
        STAMP.pack_into(data, 4, k + 1, 0)
        yield k / rate_hz, "/imu/data", bytes(data)


def of_drive(rows: list[Row]) -> Iterator[tuple[float, str, bytes]]:
    shift_ns = time.time_ns() - stamp_ns(rows[0][3])
    for at_s, topic, name, message in rows:
        shifted = stamp_ns(message) + shift_ns
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(shifted, 10**9)
        yield at_s, topic, bytes(STORE.serialize_cdr(message, name))


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def round_trips(peer: Any, messages: Iterator[tuple[float, str, bytes]]) -> tuple[list[float], int]:
    """Return how long each answer took [ms], and how many IMU messages had none."""
    sent: dict[bytes, float] = {}
    took: list[float] = []
    sent_count = 0

    def receive(until: float) -> None:
        while (left := until - time.perf_counter()) > 0.0:
            for data in peer.wait(min(left, 0.05)):
                at = sent.pop(data[4 : 4 + STAMP.size], None)
                if at is not None:
                    took.append((time.perf_counter() - at) * 1e3)

    began = time.perf_counter()
    for at_s, topic, data in messages:
        receive(began + at_s)
        if topic == "/imu/data":
            sent[data[4 : 4 + STAMP.size]] = time.perf_counter()
            sent_count += 1
        peer.send(topic, data)
    receive(time.perf_counter() + 0.5)
    return took[round(WARM_UP_FRACTION * len(took)) :], sent_count - len(took)


def report(name: str, took: list[float], unanswered: int) -> dict[str, Any]:
    if not took:
        return {"name": name, "count": 0, "unanswered": unanswered}
    median, p95, p99 = np.percentile(took, [50, 95, 99]).tolist()
    print(
        f"{name:34s} {median:7.3f} {p95:7.3f} {p99:7.3f} {max(took):7.3f} ms   {len(took)} answers, {unanswered} none",
        flush=True,
    )
    return {"name": name, "count": len(took), "unanswered": unanswered,
            "median_ms": median, "p95_ms": p95, "p99_ms": p99, "max_ms": max(took)}  # fmt: skip


def beside(target: Callable[..., None], *arguments: float) -> Any:
    process = get_context("spawn").Process(target=target, args=arguments, daemon=True)
    process.start()
    return process


def flood_fixes(domain: int, rate_hz: float) -> None:
    """Publish fixes on the topic of the left antenna, as a driver that has lost its mind."""
    publish = join(domain).advertise("/gnss/left/fix", FIX)
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](0, 0)
    header, status = types["std_msgs/msg/Header"](stamp, "gnss_left"), types["sensor_msgs/msg/NavSatStatus"](2, 1)
    covariance = (np.eye(3) * 1e-4).ravel()
    data = bytearray(STORE.serialize_cdr(types[FIX](header, status, 47.4, 8.5, 500.0, covariance, 2), FIX))
    began, sent = time.perf_counter(), 0
    while True:
        while sent < (time.perf_counter() - began) * rate_hz:
            STAMP.pack_into(data, 4, *divmod(time.time_ns(), 10**9))
            publish(bytes(data))
            sent += 1
        time.sleep(0.0005)


def measure_live(
    domain: int, folder: Path, seconds: float, arguments: Sequence[str], flood_hz: float = 0.0
) -> tuple[list[float], int]:
    subprocess.run(
        [sys.executable, "-c", HOLDFAST, "simulate", "construction", "--duration", str(seconds), "-o", str(folder)],
        check=True,
        capture_output=True,
    )
    content = YAML(typ="safe").load((folder / "config.yaml").read_text())
    (folder / "live.json").write_text(json.dumps(content | {"live": LOOPBACK | {"domain_id": domain}}))
    with AnyReader([folder / "recording.mcap"]) as reader:
        topics = {c.topic: c.msgtype for c in reader.connections if c.msgtype != TRANSFORMS}
        wanted = [c for c in reader.connections if c.topic in topics]
        rows = [(at, c.topic, c.msgtype, reader.deserialize(raw, c.msgtype)) for c, at, raw in reader.messages(wanted)]
    rows = [((at - rows[0][0]) * 1e-9, topic, name, message) for at, topic, name, message in rows]
    live = subprocess.Popen(
        [sys.executable, "-c", HOLDFAST, "live", "-c", str(folder / "live.json"), *arguments],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert live.stderr is not None
    while "publishing" not in live.stderr.readline():
        if live.poll() is not None:
            sys.exit("holdfast live has ended")
    lines: list[str] = []
    reading = Thread(target=lambda: lines.extend(live.stderr or ()), daemon=True)
    reading.start()
    peer = OverDds(domain, topics, "/holdfast/odometry/world")
    flood = beside(flood_fixes, domain, flood_hz) if flood_hz else None
    time.sleep(2.0)
    took, unanswered = round_trips(peer, of_drive(rows))
    if flood is not None:
        flood.kill()
        reading.join(0.1)
        print("".join(f"    live: {line}" for line in lines[:20]), end="")
        print(f"    live: {len(lines)} lines in all")
    live.send_signal(signal.SIGINT)
    live.wait(60)
    return took, unanswered


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each measurement")
    parser.add_argument("--json", type=Path, help="write the numbers to this file as well")
    parser.add_argument("--flood", type=float, metavar="HZ", help="measure `live` alone, without and with this")
    options = parser.parse_args()
    domain = random.SystemRandom().randrange(1, 98)
    port = 20000 + random.SystemRandom().randrange(10000)
    machine = describe_machine()
    print(", ".join(f"{key} {value}" for key, value in machine.items()))
    print(f"{'Imu in, Odometry out':34s} {'median':>7s} {'p95':>7s} {'p99':>7s} {'max':>7s}")
    results = []
    if options.flood:
        with TemporaryDirectory() as folder:
            for number, rate_hz in enumerate((0.0, options.flood), start=1):
                measured = measure_live(domain + number, Path(folder) / str(number), options.seconds, (), rate_hz)
                results.append(report(f"holdfast live, {rate_hz:g} Hz of fixes", *measured))
        return
    processes = [beside(echo_datagrams, port), beside(echo_odometry, domain)]
    time.sleep(3.0)
    datagrams, dds = OverDatagrams(port), OverDds(domain, {"/imu/data": IMU}, "/odometry")
    time.sleep(2.0)
    for rate_hz in (100, 200, 400):
        for name, peer in ((f"datagrams, {rate_hz} Hz", datagrams), (f"DDS, {rate_hz} Hz", dds)):
            results.append(report(name, *round_trips(peer, at_rate(rate_hz, options.seconds))))
    for process in processes:
        process.kill()
        process.join()
    with TemporaryDirectory() as folder:
        log = ("--record", str(Path(folder) / "log.mcap"))
        for number, (name, arguments) in enumerate((("holdfast live", ()), ("holdfast live --record", log)), start=1):
            measured = measure_live(domain + number, Path(folder) / f"drive_{number}", options.seconds, arguments)
            results.append(report(f"{name}, 100 Hz", *measured))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": machine, "round_trips": results}, indent=2) + "\n")


if __name__ == "__main__":
    main()
