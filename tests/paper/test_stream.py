"""Disturbed messages: later arrivals, other stamps, nothing lost."""

import numpy as np

from holdfast.config.load import parse_config
from holdfast.messages import FixStatus, GnssFix, ImuSample, JointAngle
from holdfast.paper.stream import disturbed
from holdfast.paper.study import Disturbance

MS = 1_000_000
CONFIG = parse_config(
    """
sensors:
  imu: {kind: imu, topic: /imu}
  gnss: {kind: gnss, topic: /left}
  gnss_right: {kind: gnss, topic: /right}
  joint: {kind: joint, topic: /joint}
extrinsics:
  - {parent: imu, child: gnss}
  - {parent: imu, child: gnss_right, translation_m: [1, 0, 0]}
"""
)


def messages():
    imu = [ImuSample(k * 10 * MS, k * 10 * MS + MS, "imu", np.zeros(3), np.zeros(3)) for k in range(100)]
    fixes = [
        GnssFix(k * 50 * MS, k * 50 * MS + 3 * MS, name, 0.0, 0.0, 0.0, None, FixStatus.FIX)
        for k in range(20)
        for name in ("gnss", "gnss_right")
    ]
    angles = [JointAngle(k * 20 * MS, k * 20 * MS + 2 * MS, "joint", 0.0) for k in range(50)]
    return sorted(imu + fixes + angles, key=lambda message: message.arrival_ns)


def test_without_a_disturbance_the_messages_are_the_same():
    given = messages()
    assert list(disturbed(given, None, CONFIG)) == given


def test_a_delay_moves_both_antennas_and_nothing_else():
    given = messages()
    found = list(disturbed(given, Disturbance("gnss", delay_s=0.3), CONFIG))
    arrivals = [message.arrival_ns for message in found]
    assert arrivals == sorted(arrivals)
    assert len(found) == len(given)
    for name in ("gnss", "gnss_right"):
        before, after = ([m for m in some if m.sensor == name] for some in (given, found))
        assert [m.arrival_ns - 300 * MS for m in after] == [m.arrival_ns for m in before]
        assert [m.stamp_ns for m in after] == [m.stamp_ns for m in before]
    others = [m for m in found if m.sensor in ("imu", "joint")]
    assert others == [m for m in given if m.sensor in ("imu", "joint")]


def test_a_wrong_clock_moves_stamps_and_not_arrivals():
    given = messages()
    found = list(disturbed(given, Disturbance("joint", clock_s=0.05), CONFIG))
    assert [m.arrival_ns for m in found] == [m.arrival_ns for m in given]
    assert [m.values() for m in found] == [m.values() for m in given]
    shifts = {m.stamp_ns - o.stamp_ns for m, o in zip(found, given, strict=True) if m.sensor == "joint"}
    assert shifts == {50 * MS}
