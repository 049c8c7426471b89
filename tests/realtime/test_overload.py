"""What happens to a flood: the newest are taken in, the rest is counted and told once a second."""

from dataclasses import replace

import pytest
from engine import bring_up

from holdfast.config.load import parse_config
from holdfast.errors import ConfigError
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.realtime.memory import Word
from holdfast.realtime.overload import Overload

CONFIG = """
sensors:
  imu: {kind: imu, topic: /imu}
  gnss: {kind: gnss, topic: /gnss}
extrinsics: [{parent: imu, child: gnss, translation_m: [0, 0, 1]}]
realtime: {max_rate_hz: 100}
"""
S = 1_000_000_000
T0 = 1_700_000_000 * S


def overload():
    log = EventLog("imu")
    return Overload(parse_config(CONFIG), log), log


def play(one, rate_hz, seconds, begin_ns=T0, sensor="gnss"):
    stamps = [begin_ns + round(k * S / rate_hz) for k in range(round(rate_hz * seconds))]
    return [at for at in stamps if one.admits(sensor, at, at)]


def test_at_its_rate_a_sensor_loses_nothing():
    one, log = overload()
    assert len(play(one, 100.0, 20.0)) == 2000
    assert not log.events and not log.counts


def test_of_a_flood_the_budget_is_taken_in_evenly_to_the_end_and_the_rest_is_counted():
    one, log = overload()
    taken = play(one, 4000.0, 10.0)
    assert 1000 <= len(taken) <= 1000 + 11
    assert log.counts["gnss", Outcome.OVERLOAD] == 40_000 - len(taken)
    assert T0 + 10 * S - taken[-1] < 0.02 * S  # the newest are among them, not only the first


def test_a_flood_is_told_once_a_second_with_the_number_that_was_left_out():
    one, log = overload()
    taken = play(one, 4000.0, 10.0)
    events = log.take_events()
    assert {event.kind for event in events} == {EventKind.OVERLOAD}
    assert len(events) == 10
    told = sum(int(event.reason.split()[0]) for event in events)
    assert 0.85 < told / (40_000 - len(taken)) <= 1.0
    assert events[-1].reason.endswith("measurements left out: more than 100 a second come")


def test_a_burst_after_a_pause_is_taken_in_and_the_room_is_known_before():
    one, _ = overload()
    play(one, 100.0, 1.0)
    assert one.room("gnss", T0 + 5 * S) == 10
    assert sum(one.admits("gnss", T0 + 5 * S, 0) for _ in range(30)) == 10


def test_nothing_of_an_imu_is_left_out():
    one, log = overload()
    assert len(play(one, 4000.0, 1.0, sensor="imu")) == 4000
    assert one.room("imu", T0) is None and not log.counts


def test_a_clock_of_arrival_that_goes_back_an_hour_starves_no_sensor():
    one, log = overload()
    play(one, 50.0, 1.0)
    assert len(play(one, 50.0, 10.0, T0 - 3600 * S)) == 500
    assert not log.events


def test_the_engine_leaves_out_a_flood_before_the_optimiser_falls_behind(drive):
    imu = [m for m in drive.until(6.0) if m.sensor == "imu"]
    fix = next(m for m in drive.until(6.0) if m.sensor == "gnss")
    with RealtimeEstimator(drive.config) as engine:
        engine.wait_until_ready()
        bring_up(engine, drive.until(5.0))
        before = engine.counts.total()
        sample = imu[-1]
        for k in range(4000):  # in a second
            arrival_ns = sample.arrival_ns + round(k * S / 4000)
            engine.process(replace(fix, stamp_ns=arrival_ns, arrival_ns=arrival_ns))
            assert engine._requests.written - engine._board.words[Word.BEGUN] < 300
        engine.flush()
        assert engine.counts["gnss", Outcome.OVERLOAD] >= 4000 - 221
        assert engine.counts.total() - before <= 4000
        told = [event for event in engine.take_events() if event.kind is EventKind.OVERLOAD]
        assert len(told) == 1 and told[0].sensor == "gnss"


@pytest.mark.parametrize(("call", "words"), [
    (lambda engine: engine.shed("x", 1, 1), r"sensor: 'x' is not in the configuration \(allowed: imu, "),
    (lambda engine: engine.shed("imu", 1, 1), "nothing of the IMU 'imu' may be left out .allowed: .*gnss"),
    (lambda engine: engine.shed("gnss", "x", 1), "number: must be an integer >= 1, got 'x'"),
    (lambda engine: engine.shed("gnss", 0, 1), "number: must be an integer >= 1, got 0"),
    (lambda engine: engine.shed("gnss", 1, "x"), "arrival_ns: must be a whole number of nanoseconds within 64 bits"),
    (lambda engine: engine.room([], 1), r"sensor: \[\] is not in the configuration"),
    (lambda engine: engine.room("gnss", 10**30), "arrival_ns: must be a whole number of nanoseconds within 64 bits"),
    (lambda engine: engine.flush("x"), "timeout_s: must be a number .s. >= 0, got 'x'"),
    (lambda engine: engine.flush(float("nan")), "timeout_s: must be a number .s. >= 0, got nan"),
    (lambda engine: engine.wait_until_ready(None), "timeout_s: must be a number .s. >= 0, got None"),
])  # fmt: skip
def test_an_argument_of_another_type_is_named_and_changes_nothing(quiet_engine, call, words):
    with pytest.raises(ConfigError, match=words):
        call(quiet_engine)
    assert quiet_engine.room("gnss", T0) == 20 and not quiet_engine.counts


@pytest.fixture(scope="module")
def quiet_engine(drive):
    with RealtimeEstimator(drive.config) as engine:
        yield engine


def test_in_step_is_true_or_false(drive):
    with pytest.raises(ConfigError, match="in_step: must be True or False, got 'no'"):
        RealtimeEstimator(drive.config, in_step="no")
