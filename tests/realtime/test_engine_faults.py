"""Whatever becomes of the optimiser or of the data: the IMU path answers every sample, and nothing is lost silently."""

import os
import signal
import time
import tracemalloc
from contextlib import contextmanager
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from engine import bring_up, play, sigmas_m, stamps_of, wait_for, with_settings

from holdfast.errors import ConfigError, EstimatorError
from holdfast.estimator.estimator import Estimator
from holdfast.events import Health
from holdfast.geometry.earth import Geodetic
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntOdometry, LearntScale, LearntSnapshot
from holdfast.messages import GnssFix, Heading, ImuSample, SensorPose
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.realtime.layout import REQUESTS

BEGIN_S = 4.0  # quick has started long before


def imu_stamps(messages):
    return [m.stamp_ns for m in messages if isinstance(m, ImuSample) and m.sensor == "imu"]


@contextmanager
def traced():
    """Memory that Python holds [bytes], whenever it is asked."""
    tracemalloc.start()
    yield lambda: tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()


def total(counts, sensor):
    return sum(count for (name, _), count in counts.items() if name == sensor)


def going_on(sample, k):
    """The sample that comes k hundredths of a second later, with noise of its own."""
    readings = sample.angular_velocity + 1e-4 * np.sin([k, 2.0 * k, 3.0 * k])
    later_ns = k * 10_000_000
    stamps = {"stamp_ns": sample.stamp_ns + later_ns, "arrival_ns": sample.arrival_ns + later_ns}
    return replace(sample, **stamps, angular_velocity=readings)


@pytest.fixture
def engine(drive):
    """An engine that has started and knows the first seconds of the drive.

    Its optimiser may be silent for long, however busy the machine is.
    """
    with RealtimeEstimator(with_settings(drive.config, realtime={"hang_s": 60.0})) as estimator:
        bring_up(estimator, drive.until(BEGIN_S))
        yield estimator


@pytest.fixture(scope="module")
def steady(drive):
    """The same, for tests after which it goes on as before."""
    with RealtimeEstimator(drive.config) as estimator:
        bring_up(estimator, drive.until(BEGIN_S))
        yield estimator


def test_the_imu_path_goes_on_while_a_killed_optimiser_is_replaced(drive, engine):
    first = engine.optimiser_pid
    anchored_ns = engine.newest_state.stamp_ns
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: engine.event_counts["optimiser_fault"] == 1)
    messages = drive.between(BEGIN_S, 7.0)
    outputs = play(engine, messages[:20])  # before its successor is there
    assert engine.health is Health.OPTIMISER_RESET
    outputs += play(engine, messages[20:400], rate=1.0)
    wait_for(lambda: engine.optimiser_pid not in {None, first})
    outputs += play(engine, messages[400:], rate=2.0)
    assert stamps_of(outputs) == imu_stamps(messages)
    engine.flush()
    assert engine.newest_state.stamp_ns > anchored_ns + 2_000_000_000
    (fault,) = (e for e in engine.take_events() if e.kind == "optimiser_fault")
    assert "signal 9" in fault.reason


def test_covariance_grows_while_there_is_no_optimiser_and_shrinks_when_it_is_back(drive, engine):
    os.kill(engine.optimiser_pid, signal.SIGSTOP)
    alone = play(engine, drive.between(BEGIN_S, 6.0), rate=2.0)
    os.kill(engine.optimiser_pid, signal.SIGCONT)
    engine.flush()
    again = play(engine, drive.between(6.0, 6.5), rate=1.0)
    sigmas, later = sigmas_m(alone)[20:], sigmas_m(again)  # what was on its way has come in the first samples
    assert (np.diff(sigmas) > 0.0).all()
    assert sigmas[-1] > 1.2 * sigmas[0]
    assert later[-1] < sigmas[-1]
    assert engine.event_counts["optimiser_fault"] == 0


def test_a_short_stop_loses_nothing(drive, engine):
    os.kill(engine.optimiser_pid, signal.SIGSTOP)
    play(engine, drive.between(BEGIN_S, 6.0))
    os.kill(engine.optimiser_pid, signal.SIGCONT)
    engine.flush()
    sent = [m for m in drive.until(6.0) if isinstance(m, GnssFix | Heading | SensorPose)]
    sensors = {m.sensor for m in sent}
    assert sensors == {"gnss", "gnss_right", "heading", "lidar"}
    waiting = len(sent) - sum(total(engine.counts, sensor) for sensor in sensors)
    assert 0 <= waiting <= len(sensors)  # of each the newest, until the IMU reaches its time
    assert engine.newest_state.stamp_ns > drive.until(6.0)[-1].stamp_ns - 500_000_000


def test_an_optimiser_that_hangs_is_replaced(drive):
    with RealtimeEstimator(with_settings(drive.config, realtime={"hang_s": 0.5})) as engine:
        bring_up(engine, drive.until(BEGIN_S))
        hung = engine.optimiser_pid
        os.kill(hung, signal.SIGSTOP)
        outputs = play(engine, drive.between(BEGIN_S, 5.0), rate=1.0)
        wait_for(lambda: engine.optimiser_pid not in {None, hung})
        outputs += play(engine, drive.between(5.0, 7.0), rate=2.0)
        messages = drive.between(BEGIN_S, 7.0)
        assert stamps_of(outputs) == imu_stamps(messages)
        engine.flush()
        assert engine.newest_state.stamp_ns > messages[-1].stamp_ns - 1_000_000_000
        assert any("hung for 0.5 s" in e.reason for e in engine.take_events() if e.kind == "optimiser_fault")


def test_an_optimiser_that_raises_is_replaced_and_reports_where(drive, engine):
    first = engine.optimiser_pid
    fix = next(m for m in drive.between(BEGIN_S, 7.0) if isinstance(m, GnssFix))
    poison = replace(fix)
    object.__setattr__(poison, "status", 99)  # which no message can be made with
    engine.process(poison)
    outputs = play(engine, drive.between(BEGIN_S, 5.0), rate=1.0)
    wait_for(lambda: engine.optimiser_pid not in {None, first})
    outputs += play(engine, drive.between(5.0, 7.0), rate=2.0)
    messages = drive.between(BEGIN_S, 7.0)
    assert stamps_of(outputs) == imu_stamps(messages)
    engine.flush()
    assert engine.newest_state.stamp_ns > messages[-1].stamp_ns - 1_000_000_000
    (fault,) = (e for e in engine.take_events() if e.kind == "optimiser_fault")
    assert "raised ValueError" in fault.reason and "99 is not a valid FixStatus" in fault.reason
    assert ".py:" in fault.reason


def test_without_an_optimiser_for_long_memory_stays_bounded_and_the_estimate_honest(drive, engine):
    os.kill(engine.optimiser_pid, signal.SIGSTOP)
    last = [m for m in drive.until(BEGIN_S) if isinstance(m, ImuSample) and m.sensor == "imu"][-1]
    estimates, held = 0, {}
    with traced() as held_now:
        for k in range(1, 4001):  # 40 s at 100 Hz, as fast as it goes
            output = engine.process(going_on(last, k))
            estimates += output.estimate is not None
            if k % 1000 == 0:
                held[k] = held_now(), sigmas_m([output])[0]
    assert estimates == 4000
    assert held[1000][1] < held[2000][1] < held[4000][1]
    assert held[4000][0] < held[2000][0] + 500_000  # 2000 samples are 2 MB
    os.kill(engine.optimiser_pid, signal.SIGCONT)
    engine.flush()
    assert engine.newest_state.stamp_ns > last.stamp_ns + 39_000_000_000


@pytest.mark.parametrize("make", [Estimator, RealtimeEstimator])
def test_memory_stays_bounded_while_it_waits_for_a_fix(drive, make):
    sample = next(m for m in drive.messages if isinstance(m, ImuSample) and m.sensor == "imu")
    estimator = make(drive.config)
    held = {}
    with traced() as held_now:
        for k in range(1, 10_001):  # 100 s
            assert estimator.process(going_on(sample, k)).estimate is None
            held[k] = held_now() if k % 2500 == 0 else 0
    assert held[10_000] < 1.25 * held[7500]  # it keeps the last 40 s
    if make is RealtimeEstimator:
        estimator.close()


def test_a_full_queue_is_counted_and_reported_once(drive):
    with RealtimeEstimator(with_settings(drive.config, realtime={"hang_s": 60.0, "max_rate_hz": 1e9})) as engine:
        engine.wait_until_ready()
        os.kill(engine.optimiser_pid, signal.SIGSTOP)
        fix = next(m for m in drive.messages if isinstance(m, GnssFix))
        sent = REQUESTS + 500
        for k in range(sent):
            engine.process(replace(fix, stamp_ns=fix.stamp_ns + 1_000_000 * k))
        late = engine.counts[fix.sensor, "late"]
        assert 500 <= late <= 600
        assert sum(e.kind == "late" for e in engine.take_events()) == 1
        os.kill(engine.optimiser_pid, signal.SIGCONT)
        engine.flush()
        assert total(engine.counts, fix.sensor) == sent


def test_samples_of_the_imu_alone_bring_new_states_in(drive, engine):
    samples = [m for m in drive.between(BEGIN_S, 6.0) if isinstance(m, ImuSample) and m.sensor == "imu"]
    outputs = play(engine, samples[:150], rate=1.0)
    assert sum(o.optimised is not None for o in outputs) >= 2  # a node each half second
    assert engine.flush().estimate is None
    before = engine.newest_state.stamp_ns
    play(engine, samples[150:], rate=1.0)
    wait_for(lambda: engine.flush().optimised is not None or engine.newest_state.stamp_ns > before)
    assert engine.newest_state.stamp_ns > before


def test_a_gap_of_the_imu_is_crossed(drive, engine):
    before = play(engine, drive.between(BEGIN_S, 5.0), rate=2.0)
    silent = [m for m in drive.between(5.0, 6.0) if not (isinstance(m, ImuSample) and m.sensor == "imu")]
    play(engine, silent, rate=2.0)
    after = play(engine, drive.between(6.0, 6.3), rate=2.0)
    engine.flush()
    assert stamps_of(after) == imu_stamps(drive.between(6.0, 6.3))
    assert not next(o.estimate for o in after if o.estimate is not None).from_imu
    assert sigmas_m(after)[0] > sigmas_m(before)[-1]
    assert engine.event_counts["imu_gap"] == 1


@pytest.mark.parametrize("by_s", [50 * 365.25 * 86400.0, -1.0])
def test_a_step_of_all_clocks_is_followed_without_a_pause(drive, engine, by_s):
    messages = [replace(m, stamp_ns=m.stamp_ns + round(by_s * 1e9)) for m in drive.between(BEGIN_S, 6.0)]
    outputs = play(engine, messages, rate=1.0)
    engine.flush()
    assert stamps_of(outputs) == imu_stamps(messages)[2:]  # two samples are no new clock yet
    assert engine.newest_state.stamp_ns > messages[-1].stamp_ns - 500_000_000
    assert engine.health_report().stamp_ns == stamps_of(outputs)[-1]
    assert engine.event_counts["optimiser_fault"] == 0
    (told,) = (e for e in engine.take_events() if e.kind == "clock_step" and e.sensor == "imu")
    assert f"by {abs(by_s):.2f} s" in told.reason and "carried over" in told.reason
    assert abs(told.stamp_ns - messages[0].stamp_ns) < 100_000_000
    assert sigmas_m(outputs)[-1] < 0.1


def test_an_estimate_that_would_not_be_finite_is_not_given(drive, engine):
    state = engine.newest_state
    broken = gtsam.NavState(state.nav.attitude(), state.nav.position(), np.full(3, np.nan))
    engine._path.anchor(replace(state, nav=broken), is_recovery=False)
    outputs = play(engine, drive.between(BEGIN_S, 4.5), rate=1.0)
    assert all(np.isfinite(o.estimate.nav.matrix()).all() for o in outputs if o.estimate is not None)
    assert engine.event_counts["optimiser_fault"] == 1
    assert engine.health is Health.INITIALISING or engine.initialised
    play(engine, drive.between(4.5, 16.0), rate=2.0)
    engine.flush()
    assert engine.initialised


def test_a_flood_of_fixes_is_all_accounted_for_and_the_state_keeps_up(drive, engine):
    messages = []
    for message in drive.between(BEGIN_S, 6.0):
        messages.append(message)
        if isinstance(message, GnssFix):  # 40 a second become 1000
            messages += [replace(message, stamp_ns=message.stamp_ns + k * 1_000_000) for k in range(1, 25)]
    outputs = play(engine, messages, rate=1.0)
    assert stamps_of(outputs) == imu_stamps(messages)
    engine.flush()
    sent = sum(isinstance(m, GnssFix) for m in drive.until(BEGIN_S)) + sum(isinstance(m, GnssFix) for m in messages)
    counted = total(engine.counts, "gnss") + total(engine.counts, "gnss_right")
    # what is later than the newest sample of the IMU waits for it: 24 copies of the newest fix of each antenna
    assert 0 <= sent - counted <= 50
    assert engine.event_counts["optimiser_fault"] == 0
    assert engine.newest_state.stamp_ns > messages[-1].stamp_ns - 1_000_000_000


@pytest.mark.parametrize(
    ("change", "outcome"),
    [
        ({"stamp_ns": 0}, "late"),
        ({"stamp_ns": 4_102_444_800_000_000_000}, "clock_jump"),
        ({"latitude_deg": float("nan")}, "not_finite"),
        ({"covariance": np.full((3, 3), np.nan)}, "no_covariance"),
    ],
)
def test_a_wrong_fix_is_counted_and_changes_nothing(drive, steady, change, outcome):
    fix = next(m for m in drive.between(BEGIN_S, 6.0) if isinstance(m, GnssFix))
    before = steady.counts[fix.sensor, outcome]
    steady.process(replace(fix, **change))
    steady.flush()
    assert steady.counts[fix.sensor, outcome] == before + 1
    assert steady.initialised


@pytest.mark.parametrize(
    ("change", "outcome"),
    [
        ({"stamp_ns": 0}, "backward"),
        ({"stamp_ns": 4_102_444_800_000_000_000}, "clock_jump"),
        ({"angular_velocity": np.array([np.nan, 0.0, 0.0])}, "not_finite"),
        ({"specific_force": np.array([0.0, 1e9, 0.0])}, "out_of_range"),
    ],
)
def test_a_wrong_sample_is_counted_and_not_answered(drive, steady, change, outcome):
    reached_ns = steady.health_report().stamp_ns
    sample = next(
        m for m in drive.messages if isinstance(m, ImuSample) and m.sensor == "imu" and m.stamp_ns > reached_ns
    )
    before = steady.counts["imu", outcome]
    assert steady.process(replace(sample, **change)).estimate is None
    assert steady.counts["imu", outcome] == before + 1
    assert steady.process(sample).estimate is not None


def test_a_sensor_that_is_not_configured_is_refused_at_once(drive):
    others = {name: section for name, section in drive.config.sensors.items() if name != "lidar"}
    config = drive.config.model_copy(update={"sensors": others})
    pose = next(m for m in drive.messages if isinstance(m, SensorPose))
    with RealtimeEstimator(config) as engine, pytest.raises(ConfigError, match=r"sensors\.lidar: not in the config"):
        engine.process(pose)


def test_a_closed_estimator_refuses_messages_but_its_log_can_be_read(drive):
    engine = RealtimeEstimator(drive.config)
    bring_up(engine, drive.until(3.0))
    pid = engine.optimiser_pid
    began = time.monotonic()
    engine.close()
    engine.close()
    assert time.monotonic() - began < 5.0
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    for call in (
        lambda: engine.process(drive.messages[0]),
        engine.flush,
        engine.wait_until_ready,
        engine.reset,
        lambda: engine.set_datum(Geodetic(47.0, 8.0, 400.0)),
    ):
        with pytest.raises(EstimatorError, match="closed"):
            call()
    assert engine.counts["gnss", "used"] > 0
    assert engine.event_counts["initialised"] == 1
    assert engine.optimiser_pid is None
    assert isinstance(engine.health, Health)


def test_an_engine_that_is_closed_at_once_leaves_nothing(drive):
    engine = RealtimeEstimator(drive.config)
    engine.close()
    assert engine.optimiser_pid is None
    assert not engine.initialised


def learnt_of(engine):
    found = engine.learnt().odometries.get("lidar")
    return None if found is None else found.translation_noise


def test_a_killed_optimiser_leaves_what_it_has_learnt_and_a_reset_forgets_it(drive):
    """The lidar of the file has a fifth of the noise: without what was learnt its successor would begin there."""
    lidar = drive.config.sensors["lidar"].model_copy(update={"translation_sigma_m": 0.001})
    config = drive.config.model_copy(update={"sensors": drive.config.sensors | {"lidar": lidar}})
    with RealtimeEstimator(config) as engine:
        bring_up(engine, drive.until(10.0))
        wait_for(lambda: learnt_of(engine) is not None)
        before, first = learnt_of(engine), engine.optimiser_pid
        assert before.log_mean > np.log(2.0)
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: engine.event_counts["optimiser_fault"] == 1)
        play(engine, drive.between(10.0, 10.3), rate=0.3)
        wait_for(lambda: engine.optimiser_pid not in {None, first})
        engine.flush()
        after = learnt_of(engine)
        assert after is not None and after.log_mean == pytest.approx(before.log_mean, abs=0.3)
        engine.reset()
        engine.flush()
        assert engine.learnt() == NOTHING_LEARNT


def test_what_was_learnt_before_goes_into_the_process_and_comes_back(drive):
    scale = LearntScale(log_mean=1.0, log_sigma=0.2)
    learnt = LearntSnapshot(odometries={"lidar": LearntOdometry(translation_noise=scale)})
    with RealtimeEstimator(drive.config, learnt=learnt) as engine:
        bring_up(engine, drive.until(BEGIN_S))
    found = engine.learnt()
    assert found.odometries["lidar"].rotation_noise is not None  # it has learnt on
    assert "gnss" in found.noise
