"""The IMU path: what it answers at once is what it makes of a sample step by step."""

import numpy as np
import pytest
from motion import Drive, G, machine, ns
from rig import truth

from holdfast.estimator.imu_path import ImuPath
from holdfast.event_log import EventLog
from holdfast.messages import ImuSample
from holdfast.sensors.imu import ImuBuffer

MOTION = Drive(start_s=0.2)


def readings(t):
    """Rate and force at a time, jittered so that no samples lie on a line."""
    force, rate = MOTION.readings(t)
    jitter = 1e-4 * np.sin([t * 977.0, t * 1231.0, t * 1511.0])
    return rate + jitter, force + jitter


def path():
    config = machine()
    return ImuPath(config, ImuBuffer(config.imu), EventLog("imu"))


def answer_or_finish(one, sample):
    output = one.answer(sample.stamp_ns, sample.arrival_ns, sample.specific_force, sample.angular_velocity)
    return output if output is not None else one.finish(sample)


def drive(take, arrays=np.array, gap_s=0.0):
    """Return a path, and each estimate of three seconds, with a fold, a new state and a silence of the IMU."""
    one, found = path(), []
    for k in range(300):
        t = 0.01 * k + (gap_s if k > 200 else 0.0)
        rate, force = readings(t)
        output = take(one, ImuSample(ns(t), ns(t) + 1000, "imu", arrays(rate), arrays(force)))
        found.append(output.estimate)
        if k == 20:
            one.start(truth(MOTION, t), G)
        if k == 150:
            one.anchor(truth(MOTION, t - 0.1), is_recovery=False)
    return one, found


def process(one, sample):
    return one.process(sample)


@pytest.mark.parametrize("gap_s", [0.0, 0.8])
def test_what_is_answered_at_once_is_what_is_made_of_a_sample_step_by_step(gap_s):
    (one, quick), (other, slow) = drive(answer_or_finish, gap_s=gap_s), drive(process, gap_s=gap_s)
    assert quick[:21] == slow[:21] == [None] * 21
    assert [estimate.stamp_ns for estimate in quick[21:]] == [estimate.stamp_ns for estimate in slow[21:]]
    assert [bytes(estimate.row) for estimate in quick[21:]] == [bytes(estimate.row) for estimate in slow[21:]]
    assert [estimate.from_imu for estimate in quick[21:]] == [estimate.from_imu for estimate in slow[21:]]
    assert all(estimate.from_imu for estimate in quick[21:200]) and one.is_running and other.is_running


def test_most_samples_are_answered_at_once():
    answered = []

    def count(one, sample):
        output = one.answer(sample.stamp_ns, sample.arrival_ns, sample.specific_force, sample.angular_velocity)
        answered.append(output is not None)
        return output or one.finish(sample)

    drive(count)
    assert sum(answered) >= 270  # not the first 21, the one after, and those at which a second is folded


@pytest.mark.parametrize(
    "arrays",
    [
        lambda values: np.array([values, values]).T[:, 0],  # not contiguous
        lambda values: values.astype(">f8"),
        lambda values: values.astype(np.longdouble),
    ],
)
def test_readings_may_lie_in_memory_as_they_like(arrays):
    (_, given), (_, plain) = drive(answer_or_finish, arrays), drive(answer_or_finish)
    assert [bytes(estimate.row) for estimate in given[21:]] == [bytes(estimate.row) for estimate in plain[21:]]


def test_whole_numbers_are_read_as_such():
    one = path()
    for k in range(3):
        sample = ImuSample(ns(0.01 * k), ns(0.01 * k), "imu", np.array([0, 0, k]), np.array([1, 2, 10]))
        answer_or_finish(one, sample)
    assert one._buffer.samples[2]["force"].tolist() == [1.0, 2.0, 10.0]
    assert one._buffer.samples[2]["rate"].tolist() == [0.0, 0.0, 2.0]


def test_an_estimate_stays_what_it_is_while_others_follow():
    _, found = drive(answer_or_finish)
    positions = [estimate.position.copy() for estimate in found[21:]]
    assert len({position.tobytes() for position in positions}) == len(positions)
    with pytest.raises(ValueError, match="read-only"):
        found[-1].position[0] = 0.0
