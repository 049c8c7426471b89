"""Positions that agree among themselves: which run is long enough, and refused enough, to be against the estimate."""

import numpy as np
import pytest
from motion import ns

from holdfast.events import Outcome
from holdfast.integrity.consensus import Consensus, agreeing
from holdfast.sensors.sensor import Position

REFUSED = Outcome.INNOVATION


def at(t, x_m, sigma_m=0.1):
    return Position(ns(t), "gnss", np.array([x_m, 0.0, 0.0]), np.eye(3) * sigma_m**2, 0.0)


def begun(count=5, duration_s=1.0):
    return Consensus(count, duration_s)


def drive(run, times, *, refused=lambda _: True, x_m=lambda t: 5.0 * t):
    for t in times:
        run.add(at(t, x_m(t)), REFUSED if refused(t) else Outcome.USED, np.zeros(3), is_expected=not refused(t))
    return run


@pytest.mark.parametrize(
    ("hz", "until_s", "is_against"),
    [
        (10.0, 0.95, False),  # too short a time
        (10.0, 1.05, True),
        (1.0, 3.5, False),  # too few, though long enough
        (1.0, 4.5, True),
    ],
)
def test_a_run_must_be_of_so_many_and_of_so_long(hz, until_s, is_against):
    assert drive(begun(), np.arange(0.0, until_s, 1.0 / hz)).is_against() == is_against


def test_a_run_that_the_estimate_mostly_accepts_is_not_against_it():
    times = np.arange(0.0, 5.0, 0.1)
    assert not drive(begun(), times, refused=lambda _: False).is_against()
    assert not drive(begun(), times, refused=lambda t: round(10.0 * t) % 2 == 0).is_against()
    assert drive(begun(), times, refused=lambda t: round(10.0 * t) % 10 != 0).is_against()  # one by chance


def test_only_the_newest_stretch_counts():
    run = drive(begun(), np.arange(0.0, 60.0, 0.1), refused=lambda _: False)
    assert not run.is_against()
    assert drive(run, np.arange(60.0, 61.5, 0.1)).is_against()


@pytest.mark.parametrize("duration_s", [1.0, 30.0])
def test_it_lasts_as_long_as_is_asked_from_the_first_that_was_refused(duration_s):
    """Positions that were accepted before do not count as time in which they were against the estimate."""
    run = drive(begun(duration_s=duration_s), np.arange(0.0, 60.0, 0.1), refused=lambda _: False)
    since = 60.0
    for t in np.arange(since, since + 2.0 * duration_s, 0.1):
        run.add(at(t, 5.0 * t), REFUSED, np.zeros(3), is_expected=False)
        if run.is_against():
            break
    assert t - since == pytest.approx(duration_s, abs=0.15)


def test_positions_that_jump_about_never_make_a_run():
    rng = np.random.default_rng(1)
    run = begun()
    for t in np.arange(0.0, 20.0, 0.1):
        run.add(at(t, rng.uniform(-100.0, 100.0)), REFUSED, np.zeros(3), is_expected=False)
        assert not run.is_against()


def test_positions_of_a_machine_that_is_faster_than_any_that_was_thought_of_agree():
    assert drive(begun(), np.arange(0.0, 1.5, 0.1), x_m=lambda t: 300.0 * t).is_against()


def test_a_speed_that_changes_faster_than_a_machine_can_ends_the_run():
    """A zigzag of 2 m at 10 Hz: each step is slower than 40 m/s, but no machine does it."""
    run = begun()
    for k in range(100):
        run.add(at(0.1 * k, 2.0 * (k % 2)), REFUSED, np.zeros(3), is_expected=False)
        assert not run.is_against()


def test_braking_and_turning_do_not_end_it():
    run = drive(begun(), np.arange(0.0, 4.0, 0.2), x_m=lambda t: 20.0 * t - 2.5 * t**2)  # 5 m/s^2
    assert run.is_against()


def test_one_or_two_outliers_are_left_out_and_a_third_begins_anew():
    for outliers, is_against in ((1, True), (2, True), (3, False)):
        run = drive(begun(), np.arange(0.0, 2.0, 0.1))
        for k in range(outliers):
            run.add(at(2.0 + 0.1 * k, 1000.0 + 300.0 * k), REFUSED, np.zeros(3), is_expected=False)
        run.add(at(2.3, 11.5), REFUSED, np.zeros(3), is_expected=False)
        assert run.is_against() == is_against


def test_one_that_was_accepted_and_taken_out_again_counts_as_refused():
    times = np.arange(0.0, 1.55, 0.1)
    run = drive(begun(), times, refused=lambda t: t > 0.95)
    assert not run.is_against()
    for t in times[:10]:
        run.contradict(at(t, 5.0 * t))
    assert run.is_against()


def test_what_comes_twice_or_in_the_wrong_order_is_not_looked_at():
    run = drive(begun(), [0.0, *np.arange(0.0, 2.0, 0.1)])
    assert run.is_against()
    assert drive(begun(), np.arange(2.0, 0.0, -0.1)).is_against() is False


def test_cleared_it_begins_anew():
    run = drive(begun(), np.arange(0.0, 2.0, 0.1))
    run.clear()
    assert not run.is_against()
    assert not drive(run, np.arange(2.0, 2.5, 0.1)).is_against()
    assert drive(run, np.arange(2.5, 3.2, 0.1)).is_against()


def test_two_that_were_refused_in_a_row_are_suspicious_and_one_that_was_accepted_ends_that():
    run = begun()
    drive(run, [0.0, 1.0], refused=lambda _: False)
    assert not run.is_suspicious()
    drive(run, [2.0])
    assert not run.is_suspicious()
    drive(run, [3.0])
    assert run.is_suspicious() and not run.is_against()
    drive(run, [4.0], refused=lambda _: False)
    assert not run.is_suspicious()


def test_two_in_a_row_that_are_not_expected_are_noticed_though_both_are_used():
    run = begun()
    for t, is_expected in ((0.0, True), (0.1, False)):
        run.add(at(t, 5.0 * t), Outcome.USED, np.zeros(3), is_expected=is_expected)
    assert not run.is_unexpected
    run.add(at(0.2, 1.0), Outcome.USED, np.zeros(3), is_expected=False)
    assert run.is_unexpected and not run.is_suspicious()
    run.add(at(0.3, 1.5), Outcome.USED, np.zeros(3), is_expected=True)
    assert not run.is_unexpected


def test_two_that_have_to_wait_because_they_are_not_expected_are_suspicious_though_none_was_refused():
    """After a silence of the IMU the estimate ran away by 130 m while fixes waited for five seconds."""
    run = drive(begun(), [0.0], refused=lambda _: False)
    for t in (0.5, 1.0):
        assert not run.is_suspicious()
        run.add(at(t, 5.0 * t), Outcome.QUARANTINED, np.zeros(3), is_expected=False)
    assert run.is_suspicious() and run.since_ns == ns(0.5) and not run.is_against()
    run.add(at(1.5, 7.5), Outcome.QUARANTINED, np.zeros(3), is_expected=True)
    assert not run.is_suspicious()


def departure(off_m, *, sigma_m=0.02, refused=lambda t: t >= 4.0, until_s=8.0):
    """Of a receiver whose positions, one a second, are so far beside the estimate at a time, and refused."""
    run = begun(duration_s=30.0)
    for t in np.arange(0.0, until_s):
        outcome = REFUSED if refused(t) else Outcome.USED
        run.add(at(t, 5.0 * t, sigma_m), outcome, np.array([0.0, off_m(t), 0.0]), is_expected=not refused(t))
    return run.departure()


def test_an_estimate_leaves_positions_faster_than_they_walk():
    found = departure(lambda t: max(0.0, 0.5 * (t - 3.0)))
    assert [one.stamp_ns for one in found.positions] == [ns(t) for t in range(8)]
    assert found.by_m == pytest.approx(2.0)


def test_what_was_long_before_tells_nothing_of_the_shape_of_the_way_and_of_how_fast_it_is_left():
    found = departure(lambda t: max(0.0, 0.5 * (t - 19.0)), refused=lambda t: t >= 20.0, until_s=40.0)
    assert [one.stamp_ns for one in found.positions] == [ns(t) for t in range(12, 40)]
    assert found.by_m == pytest.approx(6.0)


def test_rare_positions_that_are_left_have_a_shape_all_the_same():
    run = begun(duration_s=30.0)
    for t in np.arange(0.0, 60.0, 10.0):
        run.add(
            at(t, 5.0 * t),
            REFUSED if t >= 40.0 else Outcome.USED,
            np.array([0.0, max(0.0, t - 30.0), 0.0]),
            is_expected=t < 40.0,
        )
    assert [one.stamp_ns for one in run.departure().positions] == [ns(t) for t in (20.0, 30.0, 40.0, 50.0)]


@pytest.mark.parametrize(
    ("off_m", "more"),
    [
        (lambda t: max(0.0, 0.2 * (t - 3.0)), {}),  # as fast as positions may walk
        (lambda t: max(0.0, 0.5 * (t - 3.0)), {"sigma_m": 0.5}),  # within their noise
        (lambda t: max(0.0, 0.5 * (t - 3.0)), {"until_s": 5.0}),  # a single one
        (lambda t: max(0.0, 0.5 * (t - 3.0)), {"refused": lambda t: 4.0 <= t < 7.0}),  # over
    ],
)
def test_positions_that_walk_slowly_or_are_expected_again_are_not_left(off_m, more):
    assert departure(off_m, **more) is None


def test_positions_that_have_jumped_are_not_left_before_they_have_been_so_for_long():
    """Two antennas are swapped while they turn: the run begins anew, and all of it is refused."""
    more = {"refused": lambda _: True}
    assert departure(lambda t: 3.0 + 0.5 * t, until_s=12.0, **more) is None
    assert departure(lambda t: 3.0 + 0.5 * t, until_s=13.0, **more).by_m == pytest.approx(6.0)


def test_a_departure_reaches_back_to_the_last_that_was_not_refused():
    """Else positions that have jumped while none came would all be of one shape."""
    run = begun()
    for t in (0.0, 1.0, 20.0, 20.1, 20.2, 20.3, 20.4):
        off_W = np.array([50.0 * (t >= 20.0), 0.0, 0.0])
        outcome = REFUSED if t >= 20.0 else Outcome.USED
        run.add(at(t, 0.1 * t), outcome, off_W, is_expected=t < 20.0)
    found = run.departure()
    assert found.since_ns == ns(20.0)
    assert found.positions[0].stamp_ns <= ns(1.0)


@pytest.mark.parametrize("elsewhere", [{0}, {1}, {5}, {9}, {2, 9}, {4, 5}])
def test_positions_that_agree_are_those_without_outliers(elsewhere):
    one_a_second = [at(float(k), 5.0 * k + 40.0 * (k in elsewhere)) for k in range(10)]
    found = {one.stamp_ns for one in agreeing(one_a_second)}
    agree = {k for k in range(10) if one_a_second[k].stamp_ns in found}
    assert len(agree) >= 5 and not agree & elsewhere
