from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from holdfast.errors import ConfigError
from holdfast.sim.datasheets import SimulatedGnss, SimulatedHeading, SimulatedLidarOdometry
from holdfast.sim.faults import EFFECTS, apply_faults
from holdfast.sim.gnss import Antenna, Quality, gnss_readings
from holdfast.sim.heading import heading_readings
from holdfast.sim.motion import FrameMotion
from holdfast.sim.odometry import odometry_readings
from holdfast.sim.readings import Readings, generator
from holdfast.sim.scenario import FAULT_SENSORS, Fault

DURATION_S = 40.0
GNSS = SimulatedGnss(topic="/gnss", frame="gnss", rate_hz=10.0, shared_ratio=0.3)
SHEETS = {"gnss": GNSS, "gnss_right": GNSS}
FIXES = ("gnss", "gnss_right")


def drive(times_s, arm_m):
    """A machine that drives a wide circle."""
    attitude = Rotation.from_euler("z", (0.1 * times_s)[:, None])
    center = 20.0 * np.stack([np.sin(0.1 * times_s), 1.0 - np.cos(0.1 * times_s), 0.0 * times_s], axis=1)
    zero = np.zeros_like(center)
    return FrameMotion(attitude.as_matrix(), center + attitude.apply(arm_m), zero, zero, zero)


def measure(seed=0, right_rate_hz=10.0, quality=Quality.RTK_FIXED):
    rng = np.random.default_rng(seed)
    rates_hz = dict.fromkeys(("imu", "base_imu", "gnss", "heading", "joint", "lidar", "scanner"), 10.0)
    times = {name: np.arange(0.0, DURATION_S, 1.0 / rate) for name, rate in rates_hz.items()}
    times["gnss_right"] = np.arange(0.0, DURATION_S, 1.0 / right_rate_hz)
    fixed = {name: np.full(len(at), int(quality)) for name, at in times.items()}
    left, right = ({name: drive(times[name], [0.0, side, 3.0]) for name in times} for side in (1.0, -1.0))
    moving = {"gnss": left["gnss"], "gnss_right": right["gnss_right"]}
    antennas = {name: Antenna(GNSS, times[name], frame.p_W, fixed[name]) for name, frame in moving.items()}
    readings = gnss_readings(antennas, partial(generator, seed))
    for name in ("imu", "base_imu"):
        columns = ("angular_velocity", "specific_force", "gyroscope_bias")
        readings[name] = Readings(times[name], {column: rng.normal(size=(len(times[name]), 3)) for column in columns})
    readings["heading"] = heading_readings(
        SimulatedHeading(topic="/heading", frame="gnss", rate_hz=10.0),
        left["heading"],
        right["heading"],
        times["heading"],
        left_quality=fixed["heading"],
        right_quality=fixed["heading"],
        rng=rng,
    )
    readings["joint"] = Readings(times["joint"], {"angle_rad": np.sin(times["joint"])})
    lidar = SimulatedLidarOdometry(topic="/lidar", frame="lidar", rate_hz=10.0)
    readings["lidar"] = odometry_readings(lidar, left["lidar"], times["lidar"], rng)
    readings["scanner"] = Readings(times["scanner"], {})
    return readings


HEALTHY = measure()


def strike(kind, start_s=10.0, end_s=20.0, *, sensors=(), readings=HEALTHY, seed=0, **values):
    fault = Fault(kind=kind, sensors=sensors or FAULT_SENSORS[kind][:1], start_s=start_s, end_s=end_s, **values)
    return apply_faults([fault], readings, SHEETS, partial(generator, seed))


def within(readings, start_s=10.0, end_s=20.0):
    return (readings.times_s >= start_s) & (readings.times_s <= end_s)


def same(a, b):
    return a.times_s.tobytes() == b.times_s.tobytes() and all(
        a.values[name].tobytes() == b.values[name].tobytes() for name in a.values.keys() | b.values.keys()
    )


def moved_m(after, name="gnss"):
    return after[name].values["position"] - HEALTHY[name].values["position"]


# --- of all faults ----------------------------------------------------------------------------------------------------


@st.composite
def faults(draw):
    kind = draw(st.sampled_from(sorted(EFFECTS)))
    allowed = FAULT_SENSORS[kind]
    sensors = draw(st.lists(st.sampled_from(allowed), min_size=1, unique=True))
    start_s = draw(st.floats(0.0, 30.0))
    values = {
        "offset_m": draw(st.sampled_from([(1.0, 0.0, 0.0), (0.0, -20.0, 5.0)])),
        "quality": draw(st.sampled_from(["rtk_float", "single"])),
        "claim_growth_m_s": draw(st.sampled_from([None, 0.1])),
        "period_s": draw(st.floats(0.3, 4.0)),
        "yaw_deg": draw(st.floats(-20.0, 20.0)),
    }
    end_s = start_s + draw(st.floats(0.5, 9.0))
    return Fault(kind=kind, sensors=tuple(sensors), start_s=start_s, end_s=end_s, **values)


@given(faults(), st.integers(0, 3))
def test_a_fault_changes_its_sensors_within_its_interval_and_nothing_else(fault, seed):
    after = apply_faults([fault], HEALTHY, SHEETS, partial(generator, seed))
    suffering = (*FIXES, "heading") if fault.kind == "swap" else fault.sensors
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
def test_a_fix_lies_where_a_fault_moved_it_by_more_than_its_claim(fault):
    after = apply_faults([fault], HEALTHY, SHEETS, partial(generator, 0))
    for name in FIXES:
        if fault.kind in ("walk", "offset", "spikes", "swap"):
            far = (np.abs(moved_m(after, name)) > after[name].values["sigma"] * (1.0 + 1e-9)).any(axis=1)
            np.testing.assert_array_equal(after[name].values["lying"], far)
        else:
            assert not after[name].values["lying"].any()


@given(faults())
def test_identical_seeds_give_identical_bytes(fault):
    first, again = (apply_faults([fault], HEALTHY, SHEETS, partial(generator, 5)) for _ in range(2))
    assert all(same(first[name], again[name]) for name in HEALTHY)


def test_every_kind_but_the_clock_step_has_an_effect():
    assert {*EFFECTS, "clock_step"} == set(FAULT_SENSORS)
    after = strike("clock_step", step_s=0.5)
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
    lies_s = after.times_s[after.values["lying"]]
    assert (lies_s[0], len(lies_s)) == (5.0, 130) and lies_s[-1] < 18.0


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


@pytest.mark.parametrize("name", FAULT_SENSORS["silence"])
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
        assert (fixes.values["quality"] == Quality.RTK_FLOAT).all() and not fixes.values["lying"].any()
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


# --- lies -------------------------------------------------------------------------------------------------------------


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
    assert after["gnss"].values["lying"].sum() == 101
    np.testing.assert_array_equal(after["gnss"].values["sigma"], HEALTHY["gnss"].values["sigma"])


def test_an_offset_below_the_claim_and_one_without_a_solution_are_no_lies():
    assert not strike("offset", offset_m=(0.005, 0.0, 0.01))["gnss"].values["lying"].any()
    blind = measure(quality=Quality.NONE)
    assert not strike("offset", readings=blind, offset_m=(99.0, 0.0, 0.0))["gnss"].values["lying"].any()


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
    assert after["gnss"].values["lying"].sum() == 11


def test_swapped_antennas_report_each_others_fixes_and_the_heading_turns_round():
    after = strike("swap")
    inside = within(HEALTHY["gnss"])
    for mine, other in (FIXES, FIXES[::-1]):
        for column, values in after[mine].values.items():
            if column in ("position", "sigma", "quality"):
                np.testing.assert_allclose(values[inside], HEALTHY[other].values[column][inside], rtol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(after[mine].values["error"][inside, :2], axis=1), 2.0, atol=0.1)
        assert after[mine].values["lying"].sum() == inside.sum()
    turn = after["heading"].values["yaw_rad"] - HEALTHY["heading"].values["yaw_rad"]
    np.testing.assert_allclose(np.cos(turn), np.where(within(HEALTHY["heading"]), -1.0, 1.0))
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
    with pytest.raises(ConfigError, match="swap at 10 s needs fixes of gnss and gnss_right"):
        strike("swap", readings=readings)


# --- the other sensors ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["imu", "base_imu"])
def test_a_logger_draws_lines_between_the_samples_at_both_ends(name):
    before, after = HEALTHY[name], strike("line", 10.05, 20.05, sensors=(name,))[name]
    first, last = 100, 201
    share = (before.times_s[first : last + 1] - before.times_s[first]) / 10.1
    for column in ("angular_velocity", "specific_force"):
        ends = before.values[column][first], before.values[column][last]
        expected = ends[0] + np.outer(share, ends[1] - ends[0])
        np.testing.assert_allclose(after.values[column][first : last + 1], expected, atol=1e-12)
    assert after.times_s is before.times_s
    assert after.values["gyroscope_bias"] is before.values["gyroscope_bias"]


def test_a_line_to_the_end_of_the_recording_is_level():
    after = strike("line", 30.0, 50.0)["imu"].values["specific_force"]
    np.testing.assert_array_equal(after[300:], np.tile(after[299], (100, 1)))


def test_a_line_over_the_whole_recording_is_refused():
    with pytest.raises(ConfigError, match="line at 0 s leaves no sample of imu"):
        strike("line", 0.0, DURATION_S)


def relative(lidar, first, last):
    position, attitude = lidar.values["position"], Rotation.from_quat(lidar.values["quaternion"])
    return attitude[first].inv().apply(position[last] - position[first]), attitude[first].inv() * attitude[last]


def test_the_lidar_jumps_in_its_own_frame():
    before, after = HEALTHY["lidar"], strike("jump", 10.0, 10.0, offset_m=(1.0, 0.5, -0.2), yaw_deg=30.0)["lidar"]
    expected_p, expected_R = relative(before, 99, 100)
    p, R = relative(after, 99, 100)
    np.testing.assert_allclose(p, expected_p + expected_R.apply([1.0, 0.5, -0.2]), atol=1e-12)
    np.testing.assert_allclose((expected_R.inv() * R).as_rotvec(degrees=True), [0.0, 0.0, 30.0], atol=1e-9)


@pytest.mark.parametrize(("first", "last"), [(100, 101), (100, 399), (250, 390), (0, 99)])
def test_all_other_relative_motion_of_the_lidar_is_right(first, last):
    before, after = HEALTHY["lidar"], strike("jump", offset_m=(1.0, 0.5, -0.2), yaw_deg=30.0)["lidar"]
    (expected_p, expected_R), (p, R) = relative(before, first, last), relative(after, first, last)
    np.testing.assert_allclose(p, expected_p, atol=1e-12)
    assert (expected_R.inv() * R).magnitude() < 1e-12
    assert after.values["covariance"] is before.values["covariance"]


def test_a_jump_after_the_last_pose_is_none():
    assert same(strike("jump", 50.0, 50.0)["lidar"], HEALTHY["lidar"])


def test_a_frozen_encoder_repeats_its_first_angle():
    after = strike("freeze")["joint"]
    np.testing.assert_array_equal(after.values["angle_rad"][within(after)], np.sin(10.0))
    np.testing.assert_array_equal(after.values["angle_rad"][~within(after)], np.sin(after.times_s[~within(after)]))


def test_the_readings_given_are_left_alone():
    copies = {
        name: replace(one, values={column: values.copy() for column, values in one.values.items()})
        for name, one in HEALTHY.items()
    }
    events = [Fault(kind=kind, sensors=FAULT_SENSORS[kind], start_s=5.0, end_s=9.0) for kind in sorted(EFFECTS)]
    apply_faults(events, HEALTHY, SHEETS, partial(generator, 0))
    assert all(same(copies[name], HEALTHY[name]) for name in HEALTHY)
