"""The IMU buffer: which samples are accepted, and where the IMU is taken for silent."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from motion import Drive, imu, machine, ns

from holdfast.events import Outcome
from holdfast.sensors.imu import ImuBuffer

CONFIG = machine().imu
DRIVING = Drive(start_s=-3.0)


def noisy(start_s=0.0, end_s=4.0, hz=100.0, seed=3):
    return imu(DRIVING, start_s, end_s, hz, np.random.default_rng(seed))


def fed(samples, config=CONFIG):
    buffer = ImuBuffer(config)
    found = []
    for sample in samples:
        assert buffer.check(sample) is Outcome.USED
        added = buffer.add(sample)
        if added.line_since_ns is not None:
            found.append(added.line_since_ns)
    return buffer, found


def gaps(buffer, start_s=0.1, end_s=3.9):
    return [
        ((p.start_ns - ns(0)) * 1e-9, (p.end_ns - ns(0)) * 1e-9)
        for p in buffer.pieces(ns(start_s), ns(end_s))
        if p.is_gap
    ]


def drawn(samples, first, last, by=lambda samples: np.arange(len(samples), dtype=float), digits=None):
    """A logger's straight line from sample `first` to sample `last`, linear in `by`."""
    at = by(samples)
    out = list(samples)
    for k in range(first + 1, last):
        fraction = (at[k] - at[first]) / (at[last] - at[first])
        fields = {}
        for name in ("specific_force", "angular_velocity"):
            a, b = getattr(samples[first], name), getattr(samples[last], name)
            value = (1.0 - fraction) * a + fraction * b
            fields[name] = value if digits is None else np.round(value, digits)
        out[k] = replace(samples[k], **fields)
    return out


def jittered(samples, seed=7, fraction=0.2, hz=100.0):
    """Stamps that scatter as those of a busy driver do."""
    shifts = np.random.default_rng(seed).uniform(-fraction, fraction, len(samples)) / hz
    return [replace(s, stamp_ns=s.stamp_ns + round(d * 1e9)) for s, d in zip(samples, shifts, strict=True)]


def stamps_of(samples):
    return np.array([s.stamp_ns - ns(0) for s in samples]) * 1e-9


def test_a_healthy_imu_has_no_gap():
    buffer, found = fed(noisy())
    assert gaps(buffer) == [] and found == []


def test_missing_samples_are_a_gap_from_the_last_before_to_the_first_after():
    samples = noisy()
    buffer, _ = fed(samples[:150] + samples[250:])
    assert gaps(buffer) == [pytest.approx((1.49, 2.5))]


def test_a_silence_of_a_few_samples_is_none_and_a_slow_imu_sets_its_own_measure():
    samples = noisy()
    assert gaps(fed(samples[:150] + samples[154:])[0]) == []  # 50 ms
    slow = imu(DRIVING, 0.0, 12.0, 20.0, np.random.default_rng(1))
    buffer, _ = fed(slow[:150] + slow[151:])  # 100 ms, two periods of this IMU
    assert gaps(buffer, 0.1, 11.9) == []


@pytest.mark.parametrize("size", [5, 10, 20])
def test_samples_that_come_in_bursts_are_no_drop_outs_and_one_burst_that_is_missing_is(size):
    def burst_of(k):
        return k // size * size * 10_000_000 + k % size * 100_000

    samples = [replace(one, stamp_ns=ns(0) + burst_of(k)) for k, one in enumerate(noisy(end_s=8.0))]
    assert gaps(fed(samples)[0], 2.1, 7.7) == []
    lost = samples[:400] + samples[440:]
    assert gaps(fed(lost)[0], 2.1, 7.7) == [pytest.approx((4.0, 4.4), abs=size * 0.01)]


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_samples_that_are_lost_by_chance_are_no_drop_outs(share):
    """With a third of them lost no half minute was without one, and the estimator never started in motion."""
    rng = np.random.default_rng(4)
    samples = [one for one in noisy(end_s=60.0) if rng.random() > share]
    assert len(gaps(fed(samples)[0], 2.0, 59.0)) <= 3


def test_a_few_long_drop_outs_do_not_make_shorter_ones_usual():
    samples = noisy(end_s=8.0)
    silent = [one for k, one in enumerate(samples) if not 300 <= k < 340 and not 360 <= k < 400]
    assert len(gaps(fed(silent[:360] + silent[375:])[0], 0.1, 7.9)) == 3


@pytest.mark.parametrize("length", [12, 40, 150])
def test_a_straight_line_that_a_logger_drew_is_a_gap(length):
    samples = drawn(noisy(), 100, 100 + length)
    buffer, found = fed(samples)
    assert gaps(buffer) == [pytest.approx((1.0, 1.0 + length / 100.0))]
    assert found == [samples[100].stamp_ns]


@pytest.mark.parametrize("length", [12, 40, 150])
def test_a_straight_line_written_with_seven_digits_is_a_gap(length):
    buffer, found = fed(drawn(noisy(), 100, 100 + length, digits=7))
    assert gaps(buffer) == [pytest.approx((1.0, 1.0 + length / 100.0))]
    assert len(found) == 1


@pytest.mark.parametrize("length", [12, 40, 150])
def test_a_straight_line_is_found_though_the_stamps_scatter(length):
    samples = drawn(jittered(noisy()), 100, 100 + length)
    buffer, found = fed(samples)
    assert gaps(buffer) == [pytest.approx(tuple(stamps_of(samples)[[100, 100 + length]]))]
    assert len(found) == 1


@pytest.mark.parametrize("length", [12, 40, 150])
def test_a_line_that_is_straight_in_time_is_found_though_the_stamps_scatter(length):
    samples = drawn(jittered(noisy()), 100, 100 + length, by=stamps_of)
    buffer, found = fed(samples)
    assert gaps(buffer) == [pytest.approx(tuple(stamps_of(samples)[[100, 100 + length]]))]
    assert len(found) == 1


def test_frozen_readings_are_a_gap_once_they_last_half_a_second():
    samples = noisy()
    for length, is_gap in ((45, False), (80, True)):
        frozen = [
            replace(s, specific_force=samples[100].specific_force, angular_velocity=samples[100].angular_velocity)
            for s in samples[101 : 100 + length]
        ]
        buffer, found = fed(samples[:101] + frozen + samples[100 + length :])
        assert len(found) == is_gap
        # what follows the last frozen reading is a jump, no line
        assert gaps(buffer) == ([pytest.approx((1.0, 1.0 + (length - 1) / 100.0))] if is_gap else [])


@pytest.mark.parametrize("every", [2, 3, 4])
def test_readings_that_come_twice_are_no_gap(every):
    samples = noisy()
    for k in range(every, len(samples), every):
        before = samples[k - 1]
        samples[k] = replace(samples[k], specific_force=before.specific_force, angular_velocity=before.angular_velocity)
    buffer, found = fed(samples)
    assert gaps(buffer) == [] and found == []


def test_two_gaps_stay_two():
    samples = drawn(drawn(noisy(), 100, 150), 200, 260)
    buffer, found = fed(samples)
    assert gaps(buffer) == [pytest.approx((1.0, 1.5)), pytest.approx((2.0, 2.6))]
    assert len(found) == 2


def test_pieces_fill_every_interval_without_overlap_and_in_turn():
    samples = noisy()
    buffer, _ = fed(samples[:100] + samples[180:250] + samples[300:])
    rng = np.random.default_rng(0)
    for _ in range(200):
        start, end = sorted(rng.uniform(-0.5, 4.5, 2))
        pieces = buffer.pieces(ns(start), ns(end))
        assert pieces[0].start_ns == ns(start) and pieces[-1].end_ns == ns(end)
        for before, after in itertools.pairwise(pieces):
            assert before.end_ns == after.start_ns and before.is_gap != after.is_gap
        for piece in pieces:
            if not piece.is_gap:
                steps = buffer.steps(piece.start_ns, piece.end_ns)
                assert sum(s.dt_s for s in steps) == pytest.approx((piece.end_ns - piece.start_ns) * 1e-9, abs=1e-9)


def test_old_samples_are_forgotten_and_gaps_with_them():
    samples = imu(DRIVING, 0.0, 40.0, 100.0, np.random.default_rng(1))
    buffer, _ = fed(samples[:500] + samples[600:])
    buffer.forget_before(ns(39.0))
    assert buffer.oldest_ns > ns(38.0)
    assert gaps(buffer, 39.0, 40.0) == []
    assert len(buffer.steps(ns(39.0), ns(40.0))) == 100


# --- single samples ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("field", ["specific_force", "angular_velocity"])
@pytest.mark.parametrize(
    ("value", "outcome"),
    [
        (np.nan, Outcome.NOT_FINITE),
        (np.inf, Outcome.NOT_FINITE),
        (-np.inf, Outcome.NOT_FINITE),
        (1e300, Outcome.OUT_OF_RANGE),
        (-161.0, Outcome.OUT_OF_RANGE),
    ],
)
def test_readings_that_cannot_be_are_refused(field, value, outcome):
    sample = noisy()[0]
    reading = getattr(sample, field).copy()
    reading[2] = value
    assert ImuBuffer(CONFIG).check(replace(sample, **{field: reading})) is outcome


def test_stamps_that_repeat_or_go_back_are_refused():
    first, second, third = noisy()[:3]
    buffer, _ = fed([first, second])
    assert buffer.check(second) is Outcome.DUPLICATE
    assert buffer.check(first) is Outcome.BACKWARD
    assert buffer.check(replace(third, stamp_ns=0)) is Outcome.BACKWARD
    assert buffer.check(third) is Outcome.USED


def test_a_stamp_from_another_century_is_a_clock_jump():
    samples = noisy()
    buffer, _ = fed(samples[:100])
    assert buffer.check(replace(samples[100], stamp_ns=4_102_444_800_000_000_000)) is Outcome.CLOCK_JUMP


def test_a_long_pause_that_the_arrival_confirms_is_no_clock_jump():
    samples = noisy()
    buffer, _ = fed(samples[:100])
    hour = 3_600_000_000_000
    later = replace(samples[100], stamp_ns=samples[100].stamp_ns + hour, arrival_ns=samples[100].arrival_ns + hour)
    assert buffer.check(later) is Outcome.USED


def test_a_single_sample_from_ten_seconds_ahead_is_a_clock_jump():
    samples = noisy()
    buffer, _ = fed(samples[:100])
    assert buffer.check(replace(samples[100], stamp_ns=samples[100].stamp_ns + 10_000_000_000)) is Outcome.CLOCK_JUMP


def test_the_time_offset_is_added_to_every_stamp():
    config = machine(imu_={"time_offset_s": -0.25}).imu
    samples = noisy()
    buffer, _ = fed(samples, config)
    assert buffer.oldest_ns == ns(-0.25) and buffer.latest_ns == ns(3.75)
    np.testing.assert_array_equal(buffer.angular_velocity(ns(0.75)), samples[100].angular_velocity)
    assert len(buffer.steps(ns(0.0), ns(1.0))) == 100


def test_the_gyroscope_is_interpolated_between_samples_and_held_over_a_gap():
    samples = noisy()
    buffer, _ = fed(samples[:150] + samples[250:])
    middle = 0.5 * (samples[40].angular_velocity + samples[41].angular_velocity)
    np.testing.assert_allclose(buffer.angular_velocity(ns(0.405)), middle, atol=1e-12)
    np.testing.assert_array_equal(buffer.angular_velocity(ns(2.0)), samples[149].angular_velocity)
