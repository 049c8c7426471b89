"""Scans on a running machine: one waits at most, and the estimator goes on whatever becomes of their process."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from network import messages, network, stamped
from ruamel.yaml import YAML

from holdfast.config.load import parse_config
from holdfast.errors import EstimatorError
from holdfast.lidar_odometry.registration import Registered
from holdfast.lidar_odometry.shared_scan import Answer
from holdfast.live.idl import STORE
from holdfast.live.scans import HANG_S, LiveScans
from holdfast.messages import ImuSample
from holdfast.point_cloud import Layout, PointCloud, PointField
from holdfast.sensors.odometry import UNMEASURED_M

T0 = 1_700_000_000_000_000_000
CONFIG = """
sensors:
  imu: {kind: imu, topic: /imu/data}
  lidar: {kind: scans, topic: /points}
extrinsics: [{parent: imu, child: lidar, translation_m: [1, 0, 2]}]
"""


class Process:
    """A process that answers when it is told to, or dies."""

    def __init__(self, settings, _):
        self.settings, self.submitted, self.answers = settings, [], []
        self.in_flight, self.is_ready, self.is_dead, self.closed = 0, True, False, False

    def submit(self, number, scan, samples):
        self.submitted.append((number, scan, samples))
        self.in_flight += 1

    def answer(self, **answer):
        self.answers.append(answer)

    def take(self, _):
        if self.is_dead:
            raise EstimatorError("its process was killed by SIGKILL")
        if not self.answers:
            return None
        self.in_flight -= 1
        return Answer(0, **self.answers.pop(0))

    def close(self):
        self.closed = True


@pytest.fixture
def rig():
    made, clock = [], SimpleNamespace(s=100.0)

    def make(settings, placement):
        made.append(Process(settings, placement))
        return made[-1]

    scans = LiveScans(parse_config(CONFIG), "lidar", None, make, lambda: clock.s)
    return SimpleNamespace(scans=scans, made=made, clock=clock)


def scan(number):
    layout = Layout(tuple(PointField(axis, 4 * k, 7, 1) for k, axis in enumerate("xyz")), 1, 0, 12, 0, False)
    return PointCloud(T0 + number, T0 + number, "lidar", "lidar", layout, np.zeros(0, np.uint8))


def pose(number, x=0.0, **fields):
    T = np.eye(4)
    T[0, 3] = x
    return Registered(T0 + number, T, np.eye(6) * 1e-4, **fields)


def test_at_most_one_scan_waits_and_the_older_ones_are_dropped_whole_and_counted(rig):
    for number in range(5):
        rig.scans.offer(scan(number))
    [process] = rig.made
    assert [one.stamp_ns - T0 for _, one, _ in process.submitted] == [0]
    process.answer(registered=pose(0))
    [found] = rig.scans.poses(T0 + 1_000_000)
    assert (found.sensor, found.stamp_ns, found.arrival_ns) == ("lidar", T0, T0 + 1_000_000)
    assert [one.stamp_ns - T0 for _, one, _ in process.submitted] == [0, 4]  # the newest, not the oldest
    counts = rig.scans.counts
    assert (counts.received, counts.poses, counts.dropped) == (5, 1, 3)


def test_every_sample_of_the_gyroscope_goes_along_once(rig):
    def rates(*numbers):
        for k in numbers:
            rig.scans.add_sample(ImuSample(T0 + k, T0 + k, "imu", np.full(3, 0.1 * k), np.zeros(3)))

    rates(0, 1, 2)
    rig.scans.offer(scan(0))
    rates(3, 4)
    rig.scans.offer(scan(1))
    [process] = rig.made
    process.answer(registered=pose(0))
    rig.scans.poses(T0)
    assert [(samples.stamps_ns - T0).tolist() for _, _, samples in process.submitted] == [[0, 1, 2], [3, 4]]
    np.testing.assert_allclose(process.submitted[1][2].angular[:, 2], [0.3, 0.4])


def test_a_killed_process_is_told_once_and_its_successor_goes_on_where_it_was(rig):
    rig.scans.add_sample(ImuSample(T0, T0, "imu", np.zeros(3), np.zeros(3)))
    rig.scans.offer(scan(0))
    rig.made[0].answer(registered=pose(0, x=7.0))
    rig.scans.poses(T0)
    rig.scans.offer(scan(1))
    rig.made[0].is_dead = True
    rig.clock.s += 60.0
    assert rig.scans.poses(T0) == []
    assert "SIGKILL" in rig.scans.fault()
    assert rig.scans.fault() is None
    assert rig.made[0].closed and (rig.scans.counts.lost, rig.scans.counts.restarts) == (1, 1)
    assert rig.made[1].settings.T_L0_L[0, 3] == 7.0
    rig.scans.offer(scan(2))
    [(_, _, samples)] = rig.made[1].submitted
    assert samples.stamps_ns.tolist() == [T0]  # the successor needs what its predecessor knew
    rig.made[1].answer(registered=pose(2, x=7.0, restarted=True))
    [found] = rig.scans.poses(T0)
    assert np.sqrt(found.covariance[5, 5]) >= UNMEASURED_M  # nobody measured the motion in between


def test_a_process_that_hangs_is_replaced_and_one_that_keeps_dying_ever_more_slowly(rig):
    rig.scans.offer(scan(0))
    rig.clock.s += HANG_S + 0.1
    rig.scans.poses(T0)
    assert "hung" in rig.scans.fault()
    starts = []
    for _ in range(300):
        rig.clock.s += 0.1
        rig.made[-1].is_dead = True
        before = len(rig.made)
        rig.scans.poses(T0)
        starts += [rig.clock.s] * (len(rig.made) - before)
    gaps = np.diff(starts)
    assert (gaps[1:] >= gaps[:-1] - 0.2).all() and gaps[-1] > 5.0


def test_a_refused_scan_is_counted_and_its_reason_stands_in_the_diagnostics(rig):
    rig.scans.offer(scan(0))
    rig.made[0].answer(refusal="3 points lie beyond 1 m")
    assert rig.scans.poses(T0) == []
    status = rig.scans.status()
    assert status.name == "holdfast: odometry of lidar"
    assert "3 points" in status.message
    assert dict(status.values)["refused"] == "1"


def test_latency_and_processor_time_of_a_scan_are_told(rig):
    for number, cpu_s in enumerate((1.0, 1.05)):
        rig.scans.offer(scan(number))
        rig.made[0].answer(registered=pose(number), took_ns=50_000_000, cpu_s=cpu_s)
        rig.scans.poses(T0 + number + 60_000_000)
    values = dict(rig.scans.status().values)
    assert values["registration_ms_50"] == "50.0"
    assert values["scan_to_pose_ms_50"] == "60.0"
    assert values["cpu_ms_50"] == "50.0"


def test_the_process_itself_comes_up_answers_and_ends(tmp_path):
    pytest.importorskip("small_gicp")
    scans = LiveScans(parse_config(CONFIG), "lidar", None)
    try:
        end, fault = time.monotonic() + 30.0, None
        scans.offer(scan(0))
        while not scans.counts.refused and time.monotonic() < end:
            scans.poses(T0)
            time.sleep(0.01)
        assert scans.counts.refused == 1  # it has no points
        os.kill(scans._process.pid, signal.SIGKILL)
        scans.offer(scan(1))
        while (fault := fault or scans.fault()) is None and time.monotonic() < end:
            scans.poses(T0)
            time.sleep(0.01)
        assert "SIGKILL" in fault
    finally:
        scans.close()


# --- the whole machine ------------------------------------------------------------------------------------------------

ARRAY, CLOUD = "diagnostic_msgs/msg/DiagnosticArray", "sensor_msgs/msg/PointCloud2"
COMMAND = "from holdfast.cli import main; main()"


def worker_of(parent):
    """The process of the odometry that a process has started."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            if int(fields[1]) == parent and b"lidar_odometry.worker" in (folder / "cmdline").read_bytes():
                return int(folder.name)
        except OSError:
            continue
    return None


@pytest.mark.slow
def test_raw_scans_over_dds_become_an_odometry_whose_end_the_estimator_survives(live, domain, tmp_path):
    pytest.importorskip("small_gicp")
    folder = tmp_path / "quick"
    simulate = ["simulate", "quick", "--scans", "--duration", "11", "-o", str(folder)]
    subprocess.run([sys.executable, "-c", COMMAND, *simulate], check=True, capture_output=True)
    config = YAML(typ="safe").load((folder / "config.yaml").read_text())
    config["sensors"]["lidar"] |= {"kind": "scans", "topic": "/lidar/points"}
    process = live(config=config)
    process.wait_for("publishing")
    with network(domain) as net:
        net.subscribe("/diagnostics", ARRAY, reliable=True)
        told, killed = [], None

        def receive(until):
            while (left := until - time.monotonic()) > 0:
                for sample in net.wait(left):
                    found = {one.name: one for one in STORE.deserialize_cdr(sample.data, ARRAY).status}
                    told.append({entry.key: entry.value for entry in found["holdfast: odometry of lidar"].values})

        rows = [
            row for row in messages(folder / "recording.mcap") if row[1] not in ("/tf", "/tf_static", "/lidar/odometry")
        ]
        publish = {topic: net.advertise(topic, name, depth=2) for _, topic, name, _, _ in rows}
        receive(time.monotonic() + 3.0)
        began, shift_ns = time.monotonic(), time.time_ns() - rows[0][0]
        for at_ns, topic, name, _, message in rows:
            receive(began + (at_ns - rows[0][0]) * 1e-9)
            publish[topic](stamped(message, name, shift_ns))
            if killed is None and at_ns - rows[0][0] > 5e9:
                killed = worker_of(process.process.pid)
                os.kill(killed, signal.SIGKILL)
        receive(time.monotonic() + 2.0)
    process.wait_for("initialised")
    assert "warning: lidar: lidar odometry by small-gicp: " in process.wait_for(
        "killed by SIGKILL; it is started again"
    )
    assert worker_of(process.process.pid) not in (None, killed)
    last = told[-1]
    assert int(last["poses"]) > 5 and last["restarts"] == "1"
    accounted = sum(int(last[key]) for key in ("poses", "dropped", "lost", "refused"))
    assert int(last["received"]) - 2 <= accounted <= int(last["received"])
    assert float(last["scan_to_pose_ms_50"]) > 0.0 and float(last["cpu_ms_50"]) > 0.0
    assert process.end() == 130
    assert worker_of(process.process.pid) is None
