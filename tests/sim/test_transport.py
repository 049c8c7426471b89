"""Clocks and delays of simulated sensors: what is stamped how, what arrives when, and what never does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.sim.datasheets import Clock, Transport
from holdfast.sim.fault import Fault
from holdfast.sim.readings import Readings, generator
from holdfast.sim.sensors.gnss import SimulatedGnss
from holdfast.sim.sensors.scanner import SimulatedScanner
from holdfast.sim.transport import deliver, sample_times_s

START_NS = 1_700_000_000_123_456_789
TIMES = sample_times_s(20.0, 500.0)  # 10000 messages
TRUE_NS = START_NS + np.arange(10_000) * 50_000_000


def send(transport=None, clock=None, *, steps=(), seed=1, sensor_name="gnss", times=TIMES, sweeps_hz=None):
    """Messages whose column `number` tells which they were; with `sweeps_hz`, those of a scanner."""
    travel = {"transport": Transport(**(transport or {})), "clock": Clock(**(clock or {}))}
    sensor = SimulatedGnss(kind="gnss", topic="/t", frame="f", rate_hz=20.0, **travel)
    if sweeps_hz is not None:
        sensor = SimulatedScanner(kind="scanner", topic="/t", frame="f", rate_hz=sweeps_hz, **travel)
    readings = Readings(times, {"number": np.arange(len(times)), "pair": np.outer(times, [1.0, 2.0])})
    return deliver(readings, sensor, steps, START_NS, generator(seed, sensor_name, "transport"))


def step(start_s, end_s, step_s):
    return Fault(kind="clock_step", sensors=("gnss",), start_s=start_s, end_s=end_s, step_s=step_s)


def numbers(sent):
    return sent.readings.values["number"]


def delays_s(sent):
    """From the measurement to its arrival."""
    return (sent.arrivals_ns - TRUE_NS[numbers(sent)]) * 1e-9


def content(sent):
    return [a.tobytes() for a in (sent.stamps_ns, sent.arrivals_ns, sent.readings.times_s, numbers(sent))]


# --- times of measurement ---------------------------------------------------------------------------------------------


def test_sample_times_do_not_add_up_rounding():
    times = sample_times_s(30.0, 36000.0, phase_s=0.01)
    assert len(times) == 36000 * 30
    assert times[-1] == (len(times) - 1) / 30.0 + 0.01
    assert times[0] == 0.01


@given(rate=st.floats(0.1, 2000.0), duration=st.floats(0.01, 20.0), share=st.floats(0.0, 0.99))
def test_sample_times_fill_the_duration_and_end_before_it(rate, duration, share):
    phase = share / rate
    times = sample_times_s(rate, duration, phase)
    assert np.all(times < duration)
    assert np.array_equal(times, np.arange(len(times)) / rate + phase)
    assert len(times) / rate + phase >= duration  # there is no room for another


# --- stamps -----------------------------------------------------------------------------------------------------------


def test_a_perfect_clock_and_transport_stamp_and_deliver_at_the_true_time():
    sent = send()
    assert sent.stamps_ns.dtype == sent.arrivals_ns.dtype == np.int64
    assert np.array_equal(sent.stamps_ns, TRUE_NS)
    assert np.array_equal(sent.arrivals_ns, TRUE_NS)
    assert np.array_equal(numbers(sent), np.arange(10_000))
    assert np.array_equal(sent.readings.times_s, TIMES)
    assert np.array_equal(sent.readings.values["pair"], np.outer(TIMES, [1.0, 2.0]))


def test_offset_and_drift_of_a_clock_move_stamps_and_not_arrivals():
    sent = send(clock={"offset_s": -0.25, "drift_ppm": 40.0})
    assert np.array_equal(sent.stamps_ns, TRUE_NS - 250_000_000 + np.arange(10_000) * 2_000)  # 40e-6 of 50 ms
    assert np.array_equal(sent.arrivals_ns, TRUE_NS)


def test_stamp_jitter_is_normal_with_its_sigma_and_leaves_arrivals_alone():
    """10000 stamps leave 0.7 % of chance in a sigma."""
    sent = send(clock={"jitter_s": 1e-3})
    errors_s = (sent.stamps_ns - TRUE_NS) * 1e-9
    assert errors_s.std() == pytest.approx(1e-3, rel=0.03)
    assert abs(errors_s.mean()) < 4e-3 / np.sqrt(10_000)
    assert np.mean(np.abs(errors_s) < 1e-3) == pytest.approx(0.683, abs=0.02)
    assert np.array_equal(sent.arrivals_ns, TRUE_NS)


def test_a_clock_step_moves_stamps_inside_its_interval_only_and_steps_add_up():
    sent = send(steps=[step(100.0, 200.0, 0.5), step(150.0, 300.0, -0.2)])
    moved = sent.stamps_ns - TRUE_NS
    expected = [(0.0, 100.0, 0), (100.0, 150.0, 500_000_000), (150.0, 200.0, 300_000_000)]
    expected += [(200.0, 300.0, -200_000_000), (300.0, 500.0, 0)]
    for start_s, end_s, step_ns in expected:
        assert np.all(moved[round(20 * start_s) : round(20 * end_s)] == step_ns)
    assert np.array_equal(sent.arrivals_ns, TRUE_NS)


# --- arrivals ---------------------------------------------------------------------------------------------------------


def test_delay_is_latency_plus_exponential_jitter():
    """10000 messages leave 1 % of chance in mean and sigma, which are equal for an exponential."""
    late_s = delays_s(send({"latency_s": 0.08, "jitter_s": 0.02})) - 0.08
    assert late_s.min() >= -1e-9
    assert [late_s.mean(), late_s.std()] == pytest.approx([0.02, 0.02], rel=0.05)
    assert np.mean(late_s > 0.04) == pytest.approx(np.exp(-2.0), rel=0.12)


def test_jitter_of_a_period_reorders_arrivals_but_not_the_rows():
    sent = send({"jitter_s": 0.05})
    assert np.all(np.diff(numbers(sent)) == 1)
    assert np.array_equal(sent.stamps_ns, TRUE_NS)
    # of two exponential delays of mean m, one exceeds the other by a period T with probability exp(-T / m) / 2
    assert np.mean(np.diff(sent.arrivals_ns) < 0) == pytest.approx(np.exp(-1.0) / 2.0, rel=0.1)
    assert np.all(np.diff(send({"latency_s": 0.3}).arrivals_ns) > 0)


def test_lost_messages_are_their_share_at_random_and_the_others_arrive_as_without_losses():
    """Of 10000 messages 700 +- 26 are lost."""
    all_of_them, sent = send({"jitter_s": 0.02}), send({"jitter_s": 0.02, "loss_ratio": 0.07})
    arrived = np.isin(np.arange(10_000), numbers(sent))
    assert 1.0 - np.mean(arrived) == pytest.approx(0.07, abs=0.0105)
    assert np.mean(~arrived[1:] & ~arrived[:-1]) < 0.01  # losses do not come in bursts
    assert np.array_equal(sent.stamps_ns, all_of_them.stamps_ns[arrived])
    assert np.array_equal(sent.arrivals_ns, all_of_them.arrivals_ns[arrived])
    assert np.array_equal(sent.readings.values["pair"], all_of_them.readings.values["pair"][arrived])


def test_duplicates_follow_their_original_with_its_stamp_and_content_and_arrive_later():
    """Of 10000 messages 500 +- 22 arrive twice."""
    noisy = {"latency_s": 0.03, "jitter_s": 0.02}
    once, sent = send(noisy, {"jitter_s": 1e-3}), send(noisy | {"duplicate_ratio": 0.05}, {"jitter_s": 1e-3})
    copies = np.flatnonzero(np.diff(numbers(sent)) == 0) + 1
    assert len(copies) / 10_000 == pytest.approx(0.05, abs=0.009)
    assert np.array_equal(sent.stamps_ns[copies], sent.stamps_ns[copies - 1])
    assert np.array_equal(sent.readings.values["pair"][copies], sent.readings.values["pair"][copies - 1])
    later_s = (sent.arrivals_ns[copies] - sent.arrivals_ns[copies - 1]) * 1e-9
    assert later_s.min() >= 0.03 - 1e-9
    assert later_s.mean() == pytest.approx(0.05, abs=5.0 * 0.02 / np.sqrt(500))
    assert abs(np.corrcoef(later_s, delays_s(sent)[copies - 1])[0, 1]) < 4.5 / np.sqrt(500)  # the delay is a fresh one
    originals = np.delete(np.arange(len(sent.stamps_ns)), copies)
    assert np.array_equal(sent.arrivals_ns[originals], once.arrivals_ns)


def test_what_is_lost_does_not_arrive_as_a_duplicate_either():
    sent = send({"loss_ratio": 0.5, "duplicate_ratio": 0.5})
    _, times_arrived = np.unique(numbers(sent), return_counts=True)
    assert len(times_arrived) == pytest.approx(5000, abs=250)
    assert np.mean(times_arrived == 2) == pytest.approx(0.5, abs=0.04)
    assert times_arrived.max() == 2


def test_a_sweep_travels_only_when_it_is_complete():
    noisy = {"latency_s": 0.03, "jitter_s": 0.02, "duplicate_ratio": 0.1}
    at_once, sweep = send(noisy), send(noisy, sweeps_hz=10.0)
    assert np.abs(sweep.arrivals_ns - at_once.arrivals_ns - 100_000_000).max() <= 1
    assert np.array_equal(sweep.stamps_ns, at_once.stamps_ns)


FRACTION, DELAY_S = st.floats(0.0, 0.9), st.floats(0.0, 10.0)
TRANSPORT = st.fixed_dictionaries(
    {"latency_s": DELAY_S, "jitter_s": DELAY_S, "loss_ratio": FRACTION, "duplicate_ratio": FRACTION}
)


@settings(max_examples=60)
@given(transport=TRANSPORT, rate_hz=st.floats(1.2, 2000.0), seed=st.integers(0, 99))
def test_no_message_arrives_before_it_was_measured_and_complete(transport, rate_hz, seed):
    clock = {"offset_s": -9.0, "drift_ppm": 900.0, "jitter_s": 1.0}
    times = TIMES[:200] + 1.0 / 3.0
    sent = send(transport, clock, steps=[step(0.0, 5.0, 9.0)], seed=seed, times=times, sweeps_hz=rate_hz)
    assert len(numbers(sent)) > 0
    complete_s = sent.readings.times_s + 1.0 / rate_hz + transport["latency_s"]
    assert np.all(sent.arrivals_ns >= START_NS + np.floor(complete_s * 1e9).astype(int))
    assert np.array_equal(sent.readings.times_s, times[numbers(sent)])
    assert np.all(np.diff(numbers(sent)) >= 0)


def test_nothing_sent_is_nothing_delivered():
    sent = send({"duplicate_ratio": 0.5}, times=np.empty(0))
    assert len(sent.stamps_ns) == len(sent.arrivals_ns) == len(sent.readings.times_s) == 0


# --- random numbers ---------------------------------------------------------------------------------------------------

BAD = {"latency_s": 0.03, "jitter_s": 0.02, "loss_ratio": 0.05, "duplicate_ratio": 0.05}


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    assert content(send(BAD, {"jitter_s": 1e-3})) == content(send(BAD, {"jitter_s": 1e-3}))
    assert content(send(BAD, seed=1)) != content(send(BAD, seed=2))


def test_a_sensor_that_is_taken_away_changes_nothing_for_the_others():
    names = ["imu", "gnss", "lidar"]
    together = {name: content(send(BAD, sensor_name=name)) for name in names}
    without = {name: content(send(BAD, sensor_name=name)) for name in names if name != "imu"}
    assert without == {name: together[name] for name in without}
    assert together["gnss"] != together["lidar"] != together["imu"]
