"""Faults strike their sensors within their interval, and nothing else."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from struck import DURATION_S, FIXES, GNSS, HEALTHY, SHEETS, able, measure, moved_m, same, sheet, strike, within

from holdfast.errors import ConfigError
from holdfast.sim.fault import Fault
from holdfast.sim.faults import FAULTS, affected_kinds, apply_faults
from holdfast.sim.readings import generator
from holdfast.sim.sensors import KINDS
from holdfast.sim.sensors.gnss import Quality

LATER = "clock_step", "twin", "garbage"  # the work of the transport, or of who makes the messages
STRIKING = sorted({*FAULTS} - {*LATER, "flood"})  # a flood has a test of its own: test_broken_software.py

# --- of all faults ----------------------------------------------------------------------------------------------------


@st.composite
def faults(draw):
    kind = draw(st.sampled_from(STRIKING))
    sensors = draw(st.lists(st.sampled_from(able(kind)), min_size=1, unique=True))
    start_s = draw(st.floats(0.0, 30.0))
    values = {
        "offset_m": draw(st.sampled_from([(1.0, 0.0, 0.0), (0.0, -20.0, 5.0)])),
        "quality": draw(st.sampled_from(["rtk_float", "single"])),
        "claim_growth_m_s": draw(st.sampled_from([None, 0.1])),
        "period_s": draw(st.floats(0.3, 4.0)),
        "yaw_deg": draw(st.floats(-20.0, 20.0)),
        "slip_ratio": draw(st.floats(-1.0, 1.0)),
        "slip_m_s": 2.0,
    }
    end_s = start_s + draw(st.floats(0.5, 9.0))
    return Fault(kind=kind, sensors=tuple(sensors), start_s=start_s, end_s=end_s, **values)


@given(faults(), st.integers(0, 3))
def test_a_fault_changes_its_sensors_within_its_interval_and_nothing_else(fault, seed):
    after = apply_faults([fault], HEALTHY, SHEETS, partial(generator, seed))
    suffering = set(fault.sensors)
    if fault.kind == "swap" and suffering & set(FIXES):
        suffering |= {*FIXES, "heading"}
    end_s = np.inf if fault.kind == "jump" else fault.end_s
    for name, before in HEALTHY.items():
        assert same(*(one.taken(~within(one, fault.start_s, end_s)) for one in (before, after[name]))), (
            f"{name} before or after"
        )
        assert same(before, after[name]) == (name not in suffering), name


@given(faults(), st.integers(0, 3))
def test_the_error_of_a_fix_remains_position_minus_truth(fault, seed):
    after = apply_faults([fault], HEALTHY, SHEETS, partial(generator, seed))
    for name in FIXES:
        fixes = after[name].values
        truth = HEALTHY[name].values["truth"][np.isin(HEALTHY[name].times_s, after[name].times_s)]
        np.testing.assert_array_equal(fixes["truth"], truth)
        np.testing.assert_allclose(fixes["position"] - fixes["truth"], fixes["error"], atol=1e-12)


@given(faults())
def test_a_fix_is_faulty_where_a_fault_moved_it_by_more_than_its_claim(fault):
    after = apply_faults([fault], HEALTHY, SHEETS, partial(generator, 0))
    for name in FIXES:
        if fault.kind in ("walk", "offset", "spikes", "swap"):
            far = (np.abs(moved_m(after, name)) > after[name].values["sigma"] * (1.0 + 1e-9)).any(axis=1)
            np.testing.assert_array_equal(after[name].values["faulty"], far)
        else:
            assert not after[name].values["faulty"].any()


@given(faults())
def test_identical_seeds_give_identical_bytes(fault):
    first, again = (apply_faults([fault], HEALTHY, SHEETS, partial(generator, 5)) for _ in range(2))
    assert all(same(first[name], again[name]) for name in HEALTHY)


def test_every_fault_can_happen_to_a_kind_of_sensor_and_no_kind_has_another():
    assert all(affected_kinds(fault) for fault in FAULTS)
    assert {fault for kind in KINDS.values() for fault in (*kind.faults, *kind.side_effects)} <= set(FAULTS)


@pytest.mark.parametrize("kind", LATER)
def test_what_happens_later_leaves_the_readings_alone(kind):
    after = strike(kind, step_s=0.5)
    assert all(same(after[name], HEALTHY[name]) for name in HEALTHY)


def test_a_fault_of_a_sensor_without_readings_is_passed_over():
    readings = {name: HEALTHY[name] for name in ("imu", "gnss")}
    after = strike("silence", sensors=("imu", "scanner"), readings=readings)
    assert after.keys() == readings.keys() and len(after["imu"].times_s) == 299
    after = strike("degraded", sensors=FIXES, readings=readings)
    assert after.keys() == readings.keys() and not same(after["gnss"], HEALTHY["gnss"])


def test_faults_add_up_in_the_order_of_the_list():
    events = [
        Fault(kind="offset", sensors=("gnss",), start_s=5.0, end_s=15.0, offset_m=(1.0, 0.0, 0.0)),
        Fault(kind="offset", sensors=("gnss",), start_s=10.0, end_s=20.0, offset_m=(0.0, 2.0, 0.0)),
        Fault(kind="silence", sensors=("gnss",), start_s=18.0, end_s=30.0),
    ]
    after = apply_faults(events, HEALTHY, SHEETS, partial(generator, 0))["gnss"]
    moved = after.values["position"] - HEALTHY["gnss"].taken(~within(HEALTHY["gnss"], 18.0, 30.0)).values["position"]
    np.testing.assert_allclose(moved[after.times_s == 12.0], [[1.0, 2.0, 0.0]])
    np.testing.assert_allclose(moved[after.times_s == 17.0], [[0.0, 2.0, 0.0]])
    assert after.times_s[np.searchsorted(after.times_s, 18.0)] > 30.0
    faulty_s = after.times_s[after.values["faulty"]]
    assert (faulty_s[0], len(faulty_s)) == (5.0, 130) and faulty_s[-1] < 18.0


def test_two_faults_of_one_kind_draw_different_numbers():
    spikes = [
        Fault(kind="spikes", sensors=("gnss",), start_s=start_s, end_s=start_s, offset_m=(9.0, 0.0, 0.0))
        for start_s in (5.0, 10.0)
    ]
    shift = moved_m(apply_faults(spikes, HEALTHY, SHEETS, partial(generator, 0)))
    np.testing.assert_allclose(np.linalg.norm(shift[[50, 100]], axis=1), 9.0)
    assert np.linalg.norm(shift[50] - shift[100]) > 0.1


# --- outage, degraded, silence ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["gnss", "gnss_right", "heading"])
def test_an_outage_without_a_claim_is_silence(name):
    after = strike("outage", sensors=(name,))[name]
    assert same(after, HEALTHY[name].taken(~within(HEALTHY[name])))


@pytest.mark.parametrize("name", able("silence"))
def test_silence_removes_all_messages(name):
    after = strike("silence", sensors=(name,))[name]
    assert len(after.times_s) == 299 and not within(after).any()


def test_an_outage_with_a_claim_removes_the_heading_only():
    after = strike("outage", sensors=(*FIXES, "heading"), claim_growth_m_s=0.1)
    assert len(after["gnss"].times_s) == 400 and len(after["heading"].times_s) == 299


def test_an_outage_with_a_claim_wanders_off_and_says_so():
    ratios, wandered = [], []
    for seed in range(200):
        fixes = strike("outage", sensors=FIXES, seed=seed, claim_growth_m_s=0.1)["gnss"].taken(within(HEALTHY["gnss"]))
        assert (fixes.values["quality"] == Quality.RTK_FLOAT).all() and not fixes.values["faulty"].any()
        ratios.append((fixes.values["error"][-1] / fixes.values["sigma"][-1]) ** 2)
        wandered.append(fixes.values["error"][[50, 100]])
    np.testing.assert_allclose(fixes.values["sigma"][-1], 1.0, rtol=1e-3)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.2)
    np.testing.assert_allclose(np.std(wandered, axis=(0, 2)), [0.5, 1.0], rtol=0.15)


def test_both_antennas_of_an_outage_wander_together_as_far_as_they_share_their_errors():
    ends = {name: [] for name in FIXES}
    for seed in range(300):
        after = strike("outage", sensors=FIXES, seed=seed, claim_growth_m_s=0.1)
        for name in FIXES:
            ends[name].append(after[name].values["error"][200])
    left, right = np.ravel(ends["gnss"]), np.ravel(ends["gnss_right"])
    assert np.mean(left * right) / (np.std(left) * np.std(right)) == pytest.approx(0.3, abs=0.1)


@pytest.mark.parametrize("quality", ["rtk_float", "single"])
def test_degraded_fixes_err_as_their_quality_says(quality):
    fix = getattr(GNSS, quality)
    sigma_m = np.hypot(
        [fix.white_horizontal_m, fix.white_vertical_m],
        [fix.slow_horizontal_m, fix.slow_vertical_m],
    )
    errors = {name: [] for name in FIXES}
    for seed in range(100):
        after = strike("degraded", 0.0, DURATION_S, sensors=FIXES, seed=seed, quality=quality)
        for name in FIXES:
            fixes = after[name].values
            assert (fixes["quality"] == Quality[quality.upper()]).all()
            np.testing.assert_allclose(fixes["sigma"][0, 1:], sigma_m)
            errors[name].append(fixes["error"] / fixes["sigma"])
    assert np.mean(np.square(errors["gnss"])) == pytest.approx(1.0, abs=0.1)
    correlation = np.mean(np.multiply(errors["gnss"], errors["gnss_right"]))
    assert correlation == pytest.approx(0.3, abs=0.08)


def test_degraded_leaves_fixes_that_are_no_better_alone():
    single = measure(quality=Quality.SINGLE)
    assert same(strike("degraded", quality="single", readings=single)["gnss"], single["gnss"])
    assert same(strike("degraded", quality="rtk_float", readings=single)["gnss"], single["gnss"])


# --- false claims -----------------------------------------------------------------------------------------------------


def test_a_walk_goes_along_the_offset_up_to_its_length_and_claims_to_be_fixed():
    after = strike("walk", rate_m_s=0.5, offset_m=(0.0, 3.0, 4.0))
    elapsed_s = HEALTHY["gnss"].times_s[within(HEALTHY["gnss"])] - 10.0
    expected = np.outer(np.minimum(0.1 * elapsed_s, 1.0), [0.0, 3.0, 4.0])
    np.testing.assert_allclose(moved_m(after)[within(HEALTHY["gnss"])], expected, atol=1e-12)
    assert after["gnss"].values["sigma"] is HEALTHY["gnss"].values["sigma"]
    assert (after["gnss"].values["quality"] == Quality.RTK_FIXED).all()
    fast = strike("walk", rate_m_s=5.0, offset_m=(0.0, 3.0, 4.0))
    np.testing.assert_allclose(moved_m(fast)[150], [0.0, 3.0, 4.0])


def test_a_walk_of_no_length_stays():
    np.testing.assert_array_equal(moved_m(strike("walk", offset_m=(0.0, 0.0, 0.0))), 0.0)


def test_a_wrong_integer_shifts_the_fix_and_claims_to_be_fixed():
    after = strike("offset", offset_m=(0.2, -0.1, 0.4))
    np.testing.assert_allclose(moved_m(after)[within(HEALTHY["gnss"])], np.tile([0.2, -0.1, 0.4], (101, 1)))
    assert after["gnss"].values["faulty"].sum() == 101
    np.testing.assert_array_equal(after["gnss"].values["sigma"], HEALTHY["gnss"].values["sigma"])


def test_an_offset_below_the_claim_and_one_without_a_solution_are_not_faulty():
    assert not strike("offset", offset_m=(0.005, 0.0, 0.01))["gnss"].values["faulty"].any()
    blind = measure(quality=Quality.NONE)
    assert not strike("offset", readings=blind, offset_m=(99.0, 0.0, 0.0))["gnss"].values["faulty"].any()


def test_spikes_hit_one_fix_per_period_in_random_directions():
    after = strike("spikes", 10.0, 30.0, sensors=FIXES, period_s=2.0, offset_m=(3.0, 4.0, 1.0))
    for name in FIXES:
        shift = moved_m(after, name)
        hit = np.flatnonzero(np.abs(shift).any(axis=1))
        np.testing.assert_allclose(HEALTHY[name].times_s[hit], np.arange(10.0, 31.0, 2.0), atol=0.11)
        np.testing.assert_allclose(np.linalg.norm(shift[hit, :2], axis=1), 5.0)
        np.testing.assert_allclose(shift[hit, 2], 1.0)
        directions = np.arctan2(shift[hit, 1], shift[hit, 0])
        assert len(np.unique(directions.round(3))) == len(hit) and np.ptp(directions) > np.pi
    assert after["gnss"].values["faulty"].sum() == 11


def test_swapped_antennas_report_each_others_fixes_and_the_heading_is_reversed():
    after = strike("swap")
    inside = within(HEALTHY["gnss"])
    for mine, other in (FIXES, FIXES[::-1]):
        for column, values in after[mine].values.items():
            if column in ("position", "sigma", "quality"):
                np.testing.assert_allclose(values[inside], HEALTHY[other].values[column][inside], rtol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(after[mine].values["error"][inside, :2], axis=1), 2.0, atol=0.1)
        assert after[mine].values["faulty"].sum() == inside.sum()
    rotation = after["heading"].values["yaw_rad"] - HEALTHY["heading"].values["yaw_rad"]
    np.testing.assert_allclose(np.cos(rotation), np.where(within(HEALTHY["heading"]), -1.0, 1.0))
    assert np.abs(after["heading"].values["yaw_rad"]).max() <= np.pi


def test_antennas_of_different_rates_swap_by_the_nearest_time():
    readings = measure(right_rate_hz=2.5)
    after = strike("swap", readings=readings)
    left, right = after["gnss"], readings["gnss_right"]
    for row in np.flatnonzero(within(left)):
        distance_s = np.abs(right.times_s - left.times_s[row])
        nearest = right.values["position"][distance_s <= distance_s.min() + 1e-9]
        assert np.abs(nearest - left.values["position"][row]).max(axis=1).min() < 1e-12


@pytest.mark.parametrize("rest", [slice(0), slice(None)])
def test_a_swap_without_the_second_antenna_is_refused(rest):
    readings = {"gnss": HEALTHY["gnss"]}
    if rest.stop == 0:
        readings["gnss_right"] = HEALTHY["gnss_right"].taken(np.arange(0))
    with pytest.raises(ConfigError, match="swap at 10 s needs fixes of two antennas"):
        strike("swap", sensors=("gnss",), readings=readings)


def test_a_swap_of_one_named_antenna_of_three_takes_another_and_only_the_heading_between_them():
    sheets = {**SHEETS, "third": GNSS, "other_heading": sheet("heading", baseline=("gnss", "third"))}
    readings = {**HEALTHY, "third": HEALTHY["gnss_right"], "other_heading": HEALTHY["heading"]}
    fault = Fault(kind="swap", sensors=("third",), start_s=10.0, end_s=20.0)
    after = apply_faults([fault], readings, sheets, partial(generator, 0))
    changed = {name for name in readings if not same(readings[name], after[name])}
    assert changed == {"gnss", "third", "other_heading"}


def test_the_readings_given_are_left_alone():
    copies = {
        name: replace(one, values={column: values.copy() for column, values in one.values.items()})
        for name, one in HEALTHY.items()
    }
    events = [Fault(kind=kind, sensors=able(kind), start_s=5.0, end_s=9.0) for kind in STRIKING]
    apply_faults(events, HEALTHY, SHEETS, partial(generator, 0))
    assert all(same(copies[name], HEALTHY[name]) for name in HEALTHY)
