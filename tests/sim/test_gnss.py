from functools import partial

import numpy as np
import pytest

from holdfast.sim.readings import generator
from holdfast.sim.sensors.gnss import Antenna, FixQuality, Quality, SimulatedGnss, fix_quality, gnss_readings

SLOW_ONLY = FixQuality(
    white_horizontal_m=0.0,
    white_vertical_m=0.0,
    slow_horizontal_m=1.0,
    slow_vertical_m=1.0,
    time_constant_s=20.0,
    distance_constant_m=2.0,
)


SHEET = {"kind": "gnss", "topic": "/gnss", "frame": "gnss", "rate_hz": 10.0, "shared_ratio": 0.3}
SKY = {"float_below": 0.75, "single_below": 0.5, "none_below": 0.2}


def datasheet(**values):
    return SimulatedGnss(**SHEET | SKY | values)


def sigmas_m(fix):
    """East, north, up of white and slow part together."""
    horizontal = np.hypot(fix.white_horizontal_m, fix.slow_horizontal_m)
    return np.array([horizontal, horizontal, np.hypot(fix.white_vertical_m, fix.slow_vertical_m)])


def antenna(sheet, duration_s=60.0, rate_hz=10.0, speed_m_s=0.0, *, quality=Quality.RTK_FIXED, aside_m=0.0):
    times_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    p_W = np.outer(times_s, [speed_m_s, 0.0, 0.0]) + np.array([100.0, 50.0 + aside_m, 3.0])
    return Antenna(sheet, times_s, p_W, np.broadcast_to(np.int64(quality), times_s.shape))


def measure(seed, *antennas):
    readings = gnss_readings(dict(zip(("gnss", "gnss_right"), antennas, strict=False)), partial(generator, seed))
    return [one.values for one in readings.values()]


# --- quality ----------------------------------------------------------------------------------------------------------


def test_quality_falls_with_the_open_sky():
    sheet = datasheet()
    sky = np.array([1.0, 0.75, 0.74, 0.5, 0.49, 0.2, 0.19, 0.0])
    assert fix_quality(sheet, np.arange(8.0), sky).tolist() == [3, 3, 2, 2, 1, 1, 0, 0]


def test_an_open_sky_at_the_start_is_fixed_at_once():
    assert (fix_quality(datasheet(refix_s=6.0), np.arange(20.0), np.ones(20)) == Quality.RTK_FIXED).all()


@pytest.mark.parametrize("depth", [0.1, 0.3, 0.6])
def test_a_fix_needs_good_sky_for_refix_s_after_any_fall(depth):
    times_s = np.arange(0.0, 30.0, 0.1)
    sky = np.where((times_s > 4.95) & (times_s < 8.05), depth, 0.9)
    quality = fix_quality(datasheet(refix_s=6.0), times_s, sky)
    assert (quality[times_s < 4.95] == Quality.RTK_FIXED).all()
    assert (quality[(times_s > 4.95) & (times_s < 8.05)] < Quality.RTK_FIXED).all()
    # the good sky begins at 8.1 s
    assert (quality[(times_s > 8.05) & (times_s < 14.05)] == Quality.RTK_FLOAT).all()
    assert (quality[times_s > 14.05] == Quality.RTK_FIXED).all()


def test_a_short_fall_starts_the_wait_again():
    times_s = np.arange(0.0, 30.0)
    sky = np.where(np.isin(times_s, [2.0, 7.0]), 0.6, 1.0)
    quality = fix_quality(datasheet(refix_s=6.0), times_s, sky)
    assert (quality[2:14] == Quality.RTK_FLOAT).all() and (quality[14:] == Quality.RTK_FIXED).all()


def test_bad_sky_at_the_start_delays_the_first_fix():
    times_s = np.arange(0.0, 10.0)
    quality = fix_quality(datasheet(refix_s=3.0), times_s, np.where(times_s < 2.0, 0.0, 1.0))
    assert quality.tolist() == [0, 0, 2, 2, 2, 3, 3, 3, 3, 3]


# --- errors and claims ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("quality", [Quality.SINGLE, Quality.RTK_FLOAT, Quality.RTK_FIXED])
@pytest.mark.parametrize("speed_m_s", [0.0, 0.8])
def test_claims_are_honest(quality, speed_m_s):
    where = antenna(datasheet(), duration_s=300.0, rate_hz=1.0, speed_m_s=speed_m_s, quality=quality)
    ratios = []
    for seed in range(100):
        (fixes,) = measure(seed, where)
        ratios.append(np.mean((fixes["error"] / fixes["sigma"]) ** 2, axis=0))
    assert 0.9 < np.mean(ratios) < 1.1
    assert np.all(np.abs(np.mean(ratios, axis=0) - 1.0) < 0.2)  # east, north and up on their own


def test_the_fixed_solution_is_what_the_datasheet_says():
    errors = np.concatenate([measure(seed, antenna(datasheet(), 200.0, 1.0))[0]["error"] for seed in range(100)])
    np.testing.assert_allclose(np.std(errors, axis=0), sigmas_m(datasheet().rtk_fixed), rtol=0.05)


def test_a_boasting_receiver_claims_less_than_it_errs():
    honest, boasting = (antenna(datasheet(claim_ratio=ratio)) for ratio in (1.0, 0.5))
    for seed in range(3):
        (truth,), (boast,) = measure(seed, honest), measure(seed, boasting)
        np.testing.assert_array_equal(truth["error"], boast["error"])
        np.testing.assert_allclose(boast["sigma"], truth["sigma"] / 2.0)


def test_error_and_claim_follow_the_quality_of_each_fix():
    qualities = np.repeat([3, 2, 1, 0, 3], 600)
    times_s = np.arange(3000) * 0.1
    p_W = np.outer(times_s, [1.0, 0.0, 0.0])
    errors = []
    for seed in range(30):
        (fixes,) = measure(seed, Antenna(datasheet(), times_s, p_W, qualities))
        errors.append(fixes["error"].reshape(5, 600, 3))
    scatter = np.sqrt(np.mean(np.square(errors), axis=(0, 2)))
    claims = fixes["sigma"].reshape(5, 600, 3)
    np.testing.assert_array_equal(claims[0], claims[4])
    for part, fix in enumerate((datasheet().rtk_fixed, datasheet().rtk_float, datasheet().single)):
        np.testing.assert_allclose(claims[part], np.tile(sigmas_m(fix), (600, 1)))
    np.testing.assert_allclose(scatter[[0, 1, 2, 4]], claims[[0, 1, 2, 4], 0], rtol=0.25)


def test_rows_without_a_solution_are_kept_and_finite():
    (fixes,) = measure(0, antenna(datasheet(), quality=Quality.NONE))
    assert len(fixes["quality"]) == 600 and (fixes["quality"] == Quality.NONE).all()
    assert np.isfinite(fixes["position"]).all() and np.isfinite(fixes["sigma"]).all()


def test_position_is_truth_plus_error_and_nobody_lies_without_a_fault():
    where = antenna(datasheet(), speed_m_s=1.0)
    (fixes,) = measure(4, where)
    np.testing.assert_array_equal(fixes["truth"], where.p_W)
    np.testing.assert_allclose(fixes["position"] - fixes["truth"], fixes["error"], atol=1e-12)
    assert np.all(np.std(fixes["error"], axis=0) > 1e-3) and not fixes["faulty"].any()


# --- the slow part ----------------------------------------------------------------------------------------------------


def correlation(a, b):
    return float(np.mean(a * b) / np.sqrt(np.mean(a**2) * np.mean(b**2)))


def slow_errors(speed_m_s, seeds=150):
    where = antenna(datasheet(rtk_fixed=SLOW_ONLY), 120.0, 1.0, speed_m_s)
    return np.stack([measure(seed, where)[0]["error"] for seed in range(seeds)])


@pytest.mark.parametrize("speed_m_s", [0.0, 0.05, 0.5])
def test_the_slow_error_decorrelates_with_time_and_with_the_way(speed_m_s):
    errors = slow_errors(speed_m_s)
    for lag_s in (1, 5, 15):
        expected = np.exp(-lag_s / 20.0 - lag_s * speed_m_s / 2.0)
        assert correlation(errors[:, :-lag_s], errors[:, lag_s:]) == pytest.approx(expected, abs=0.06)


def test_the_slow_error_has_its_full_size_from_the_first_fix_on():
    first = slow_errors(0.0)[:, 0]
    assert np.std(first) == pytest.approx(1.0, abs=0.12)


def test_the_slow_error_of_one_axis_says_nothing_about_another():
    errors = slow_errors(0.5)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert abs(correlation(errors[..., a], errors[..., b])) < 0.06


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("right_rate_hz", [1.0, 5.0])
def test_both_antennas_share_the_stated_part_of_the_slow_error(ratio, right_rate_hz):
    sheet = datasheet(rtk_fixed=SLOW_ONLY, shared_ratio=ratio)
    lefts, rights = [], []
    for seed in range(60):
        left, right = measure(
            seed, antenna(sheet, 120.0, 1.0, 0.5), antenna(sheet, 120.0, right_rate_hz, 0.5, aside_m=2.0)
        )
        lefts.append(left["error"])
        rights.append(right["error"][:: int(right_rate_hz)])
    assert correlation(np.array(lefts), np.array(rights)) == pytest.approx(ratio, abs=0.06)
    assert np.std(rights) == pytest.approx(1.0, abs=0.06)


def test_white_noise_is_not_shared():
    sheet, fix = datasheet(shared_ratio=1.0), datasheet().rtk_fixed
    left, right = measure(1, antenna(sheet, 600.0), antenna(sheet, 600.0))
    difference = left["error"] - right["error"]
    np.testing.assert_allclose(
        np.std(difference, axis=0),
        np.sqrt(2.0) * np.array([fix.white_horizontal_m] * 2 + [fix.white_vertical_m]),
        rtol=0.05,
    )


# --- determinism ------------------------------------------------------------------------------------------------------


def test_a_second_antenna_never_changes_the_fixes_of_the_first():
    left = antenna(datasheet(), 60.0, 10.0, 0.3)
    (alone,) = measure(7, left)
    together, right = measure(7, left, antenna(datasheet(), 50.0, 3.0, 0.3, aside_m=2.0))
    assert alone["position"].tobytes() == together["position"].tobytes()
    assert len(right["position"]) == 150


def test_identical_seeds_give_identical_bytes_and_others_do_not():
    first, again, other = (measure(seed, antenna(datasheet()))[0]["position"].tobytes() for seed in (3, 3, 4))
    assert first == again != other


def test_a_machine_without_antennas_has_no_fixes():
    assert gnss_readings({}, partial(generator, 0)) == {}
