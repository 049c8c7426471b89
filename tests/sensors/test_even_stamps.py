"""Stamps given at arrival are put where the receiver has measured; even ones, and those of others, stay as they are."""

import numpy as np
import pytest

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.messages import FixStatus, GnssFix, GnssVelocity, SensorPose
from holdfast.sensors.even_stamps import ENOUGH, MEMORY, EvenStamps

START_NS = 1_700_000_000_000_000_000
COUNT = 200
SETTLED = 40  # messages


def fix(stamp_ns, sensor="gnss"):
    return GnssFix(stamp_ns, stamp_ns, sensor, 47.0, 8.0, 400.0, None, FixStatus.GBAS)


def at(t):
    return START_NS + round(t * 1e9)


def errors_s(even, true_s, given_s):
    """By how much the stamps that are read are beside the truth, but for what all have in common."""
    read = np.array([even.read(fix(at(t))).stamp_ns - START_NS for t in given_s]) * 1e-9
    return read - true_s


def news(log):
    return [event.reason for event in log.take_events() if event.kind is EventKind.NOISE]


@pytest.mark.parametrize("hz", [1.0, 4.0, 10.0, 20.0])
@pytest.mark.parametrize("share", [0.04, 0.15], ids=["of a twentieth", "of a seventh"])
def test_jitter_falls_to_a_third_whatever_the_rate(hz, share):
    rng, true_s = np.random.default_rng(1), np.arange(COUNT) / hz
    jitter_s = rng.uniform(-share / hz, share / hz, COUNT)
    log = EventLog("imu")
    left_s = errors_s(EvenStamps(log), true_s, true_s + jitter_s)[SETTLED:]
    assert np.sqrt(np.mean(left_s**2)) < np.sqrt(np.mean(jitter_s[SETTLED:] ** 2)) / 3.0
    (told,) = news(log)
    assert float(told.split()[-2]) == pytest.approx(1.0 / hz, rel=0.02)  # as it is first known


def test_delays_of_a_line_with_lost_messages_and_hiccups():
    """The mean of the delays is left: it is a clock that is off."""
    rng, true_s = np.random.default_rng(2), np.arange(COUNT) * 0.25
    delays_s = rng.exponential(0.02, COUNT) + 0.1 * (rng.random(COUNT) < 0.03)
    kept = rng.random(COUNT) > 0.1
    left_s = errors_s(EvenStamps(EventLog("imu")), true_s[kept], (true_s + delays_s)[kept])[SETTLED:]
    assert np.std(left_s) < 0.25 * np.std(delays_s[kept][SETTLED:])
    assert abs(np.mean(left_s) - 0.02) < 0.01


@pytest.mark.parametrize("period_s", [1.0, 0.25, 0.1, 1.0 / 3.0])
def test_even_stamps_stay_as_they_are(period_s):
    log = EventLog("imu")
    even = EvenStamps(log)
    for k in range(COUNT):
        message = fix(at(round(k * period_s, 3)))  # in whole milliseconds
        assert even.read(message) is message
    assert not news(log)


def test_a_logger_that_hangs_now_and_then_does_not_jitter():
    """KITTI's unit does so eight times."""
    even = EvenStamps(EventLog("imu"))
    for k in range(COUNT):
        message = fix(at(k + (0.05 if k % 25 == 24 else 0.0)))
        assert even.read(message) is message


def test_a_clock_that_steps_is_no_jitter():
    even = EvenStamps(EventLog("imu"))
    for k in range(COUNT):
        message = fix(at(0.2 * k + 0.07 * (k >= 60) + 0.05 * (k >= 120)))
        assert even.read(message) is message


def test_two_stamps_to_an_epoch_or_a_clock_that_walks_are_no_jitter_about_one_line():
    rng = np.random.default_rng(12)
    twice_s = np.sort(np.concatenate([0.25 * np.arange(100), 0.25 * np.arange(100) + rng.uniform(0.001, 0.02, 100)]))
    walking_s = 0.25 * np.arange(COUNT) + np.cumsum(rng.normal(0.0, 0.005, COUNT))
    for given_s in (twice_s, walking_s):
        read_s = errors_s(EvenStamps(EventLog("imu")), given_s, given_s)
        assert np.abs(read_s).max() < 0.02


def test_after_a_step_jittering_stamps_are_learnt_again():
    rng, true_s = np.random.default_rng(3), np.arange(COUNT) * 0.25
    jitter_s = rng.uniform(-0.01, 0.01, COUNT)
    step_s = np.where(true_s > 25.0, 0.1, 0.0)
    left_s = errors_s(EvenStamps(EventLog("imu")), true_s + step_s, true_s + step_s + jitter_s)
    after = left_s[true_s > 25.0]
    assert np.abs(after[5:]).max() <= 0.01  # given as they are for a while: no worse than they were
    assert np.abs(after[SETTLED:]).max() < 0.005


def test_another_rate_is_learnt():
    rng = np.random.default_rng(4)
    true_s = np.concatenate([np.arange(100) * 0.5, 50.0 + np.arange(300) * 0.1])
    jitter_s = rng.uniform(-0.01, 0.01, len(true_s))
    left_s = errors_s(EvenStamps(EventLog("imu")), true_s, true_s + jitter_s)
    assert np.abs(left_s[-50:]).max() < 0.005


def test_what_is_said_at_once_stays_together_and_shares_its_epochs():
    """A velocity comes with every fix and between them; each alone would come at half the rate."""
    rng, even = np.random.default_rng(5), EvenStamps(EventLog("imu"))
    for k in range(COUNT):
        stamp_ns = at(0.25 * k + rng.uniform(-0.02, 0.02))
        velocity = GnssVelocity(stamp_ns, stamp_ns, "doppler", np.zeros(3), np.eye(3))
        read = [even.read(one).stamp_ns for one in ([fix(stamp_ns), velocity] if k % 2 == 0 else [velocity])]
        assert len(set(read)) == 1
        assert k < SETTLED or abs(read[0] - at(0.25 * k)) < 8e6


def test_a_message_that_comes_twice_is_the_same_twice():
    rng, even = np.random.default_rng(6), EvenStamps(EventLog("imu"))
    for k in range(COUNT):
        message = fix(at(0.25 * k + rng.uniform(-0.02, 0.02)))
        assert even.read(message).stamp_ns == even.read(message).stamp_ns


def test_one_that_was_overtaken_is_put_where_it_belongs():
    rng, even = np.random.default_rng(7), EvenStamps(EventLog("imu"))
    order = np.arange(COUNT)
    order[100:102] = 101, 100
    for k in order:
        read_ns = even.read(fix(at(0.25 * k + rng.uniform(-0.02, 0.02)))).stamp_ns
        assert k < SETTLED or abs(read_ns - at(0.25 * k)) < 8e6


def test_other_sensors_may_measure_when_they_like():
    rng, even = np.random.default_rng(8), EvenStamps(EventLog("imu"))
    for k in range(COUNT):
        stamp_ns = at(0.1 * k + rng.uniform(-0.01, 0.01))
        pose = SensorPose(stamp_ns, stamp_ns, "lidar", np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), None)
        assert even.read(pose) is pose


def test_where_positions_scatter_less_at_the_stamps_given_these_are_right():
    rng, log = np.random.default_rng(9), EventLog("imu")
    even = EvenStamps(log)
    for k in range(COUNT):
        message = fix(at(0.25 * k + rng.uniform(-0.02, 0.02)))
        read = even.read(message)
        if k < ENOUGH:
            continue
        assert even.moved_ns("gnss") == message.stamp_ns - read.stamp_ns
        if k < 2 * ENOUGH:
            even.judge("gnss", 1.0, 1.2, read.stamp_ns)  # chance
        elif k < 100:
            even.judge("gnss", 1.0, 20.0, read.stamp_ns)
        else:
            assert read is message
    assert news(log)[-1] == "its uneven stamps are right: used as they are"


def test_it_remembers_no_more_than_it_says():
    rng, even = np.random.default_rng(10), EvenStamps(EventLog("imu"))
    for k in range(3 * MEMORY):
        even.read(fix(at(0.25 * k + rng.uniform(-0.02, 0.02))))
    assert len(even._known) == MEMORY
