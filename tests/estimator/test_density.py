"""A sensor that sends thousands of measurements a second is thinned out: the work that it causes is bounded."""

import random
from itertools import pairwise

from holdfast.config.load import parse_config
from holdfast.estimator.density import Density
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome

CONFIG = """
sensors:
  imu: {kind: imu, topic: /imu}
  gnss: {kind: gnss, topic: /gnss}
extrinsics: [{parent: imu, child: gnss, translation_m: [0, 0, 1]}]
realtime: {max_rate_hz: 100}
"""
S = 1_000_000_000
T0 = 1_700_000_000 * S


def density():
    log = EventLog("imu")
    return Density(parse_config(CONFIG), log), log


def stamps(rate_hz, seconds):
    return [T0 + round(k * S / rate_hz) for k in range(round(rate_hz * seconds))]


def test_at_its_rate_a_sensor_loses_nothing_jittered_or_not():
    one, log = density()
    jitter = random.Random(0)
    for at in stamps(50.0, 20.0):
        assert one.admits("gnss", at + jitter.randrange(-S // 200, S // 200), at)
    assert not log.events and not log.counts


def test_of_a_flood_so_many_a_second_are_taken_in_through_all_of_it_and_the_rest_is_counted():
    one, log = density()
    taken = [at for at in stamps(4000.0, 10.0) if one.admits("gnss", at, at)]
    assert len(taken) == 1000
    assert max(b - a for a, b in pairwise(taken)) <= 0.04 * S
    assert log.counts["gnss", Outcome.OVERLOAD] == 39_000
    events = log.take_events()
    assert {event.kind for event in events} == {EventKind.OVERLOAD}
    assert len(events) == 10


def test_the_bound_holds_whatever_the_order_of_the_stamps():
    one, _ = density()
    shuffled = stamps(4000.0, 10.0)
    random.Random(1).shuffle(shuffled)
    assert sum(one.admits("gnss", at, T0) for at in shuffled) == 1000


def test_each_sensor_has_a_bound_of_its_own():
    one, _ = density()
    for at in stamps(4000.0, 1.0):
        one.admits("gnss", at, at)
    assert one.admits("other", T0, T0)
