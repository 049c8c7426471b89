"""The simulated IMU: exact signals of a known motion, and errors as its datasheet says."""

import numpy as np
import pytest
from sampled import sampled
from scipy.spatial.transform import Rotation
from strapdown import integrate

from holdfast.geometry.earth import EARTH_RATE_RAD_S, earth_rate_enu, gravity
from holdfast.sim.readings import generator
from holdfast.sim.scene import FrameMotion
from holdfast.sim.sensors.imu import SimulatedImu, true_signals
from holdfast.sim.transport import sample_times_s

LATITUDE_DEG = 47.4
G = gravity(LATITUDE_DEG, 450.0)
EARTH = earth_rate_enu(LATITUDE_DEG)
TILT = Rotation.from_euler("xyz", [0.08, -0.1, 0.4]).as_matrix()
TURNING_POINT, FULL_SPEED = np.pi / 2.0, 0.0  # phase of a vibration at time 0
NO_ERRORS = dict.fromkeys(
    [
        f"{kind}_{error}"
        for kind in ("accelerometer", "gyroscope")
        for error in ("noise_density", "random_walk", "bias_sigma", "scale_sigma", "resolution")
    ]
    + ["misalignment_sigma_rad"],
    0.0,
)


def imu(rate_hz=100.0, **errors):
    """An IMU with the named errors only."""
    return SimulatedImu(kind="imu", topic="/imu", frame="imu", rate_hz=rate_hz, **(NO_ERRORS | errors))


def slewing(times_s, vibration_m_s2=0.0, phase=TURNING_POINT):
    """A tilted circle with nodding and rising, slewed at about 0.6 rad/s, shaken at 28 Hz on every axis."""
    t = times_s
    yaw, yaw_rate = 0.6 * t + 0.3 * (1.0 - np.cos(0.4 * t)), 0.6 + 0.12 * np.sin(0.4 * t)
    yaw_acceleration = 0.048 * np.cos(0.4 * t)
    nod, nod_rate = 0.05 * np.sin(1.3 * t), 0.065 * np.cos(1.3 * t)
    outward = 1.5 * np.stack([np.cos(yaw), np.sin(yaw), 0.0 * t], axis=1)
    along = 1.5 * np.stack([-np.sin(yaw), np.cos(yaw), 0.0 * t], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    p = outward + np.outer(0.1 * np.sin(0.7 * t), up)
    v = along * yaw_rate[:, None] + np.outer(0.07 * np.cos(0.7 * t), up)
    a = along * yaw_acceleration[:, None] - outward * yaw_rate[:, None] ** 2 - np.outer(0.049 * np.sin(0.7 * t), up)
    omega = 2.0 * np.pi * 28.0
    shaking = vibration_m_s2 * np.sin(omega * t + phase)[:, None]
    shaking_velocity = -vibration_m_s2 / omega * np.cos(omega * t + phase)[:, None]
    turn = Rotation.from_euler("z", yaw[:, None]) * Rotation.from_euler("y", nod[:, None])
    return FrameMotion(
        TILT @ turn.as_matrix(),
        p @ TILT.T - shaking / omega**2,
        v @ TILT.T + shaking_velocity,
        a @ TILT.T + shaking,
        np.stack([-np.sin(nod) * yaw_rate, nod_rate, np.cos(nod) * yaw_rate], axis=1),
    )


def standing(count, attitude=TILT, v_W=(0.0, 0.0, 0.0)):
    """At rest, or in straight motion that never gets anywhere: only velocity and attitude matter to an IMU."""
    zero = np.zeros((count, 3))
    return FrameMotion(np.tile(attitude, (count, 1, 1)), zero, zero + np.array(v_W), zero, zero)


def misses(rate_hz, earth, assumed_earth, **vibration):
    """Position [m] and attitude [deg] by which 60 s of integrated exact signals miss the truth at most."""
    times = sample_times_s(rate_hz, 60.0 + 1e-9)
    truth = slewing(times, **vibration)
    signals = true_signals(truth, G, earth)
    R, p, _ = integrate(times, *signals, truth.R_W_F[0], truth.p_W[0], truth.v_W[0], G, assumed_earth)
    turned = Rotation.from_matrix(np.swapaxes(truth.R_W_F, 1, 2) @ R).magnitude()
    return np.linalg.norm(p - truth.p_W, axis=1).max(), np.degrees(turned.max())


def allan_deviation(readings, rate_hz, tau_s):
    """Overlapping Allan deviation of (N, 3) readings, per axis (IEEE Std 952, annex on the Allan variance).

    With theta the integral of the readings: variance = mean((theta_{k+2m} - 2 theta_{k+m} + theta_k)^2) / (2 tau^2).
    """
    m = round(tau_s * rate_hz)
    theta = np.cumsum(np.vstack([np.zeros(3), readings]), axis=0) / rate_hz
    second = theta[2 * m :] - 2.0 * theta[m:-m] + theta[: -2 * m]
    return np.sqrt(np.mean(second**2, axis=0) / (2.0 * tau_s**2))


def allan_over_seeds(sheet, duration_s, tau_s, seeds):
    """Allan deviation of a standing accelerometer and gyroscope, root mean square over axes and seeds."""
    times = sample_times_s(sheet.rate_hz, duration_s)
    squares = []
    for seed in range(seeds):
        readings = sampled(sheet, standing(len(times)), times, generator(seed, "imu"))
        squares.append(
            [
                np.mean(allan_deviation(readings.values[name], sheet.rate_hz, tau_s) ** 2)
                for name in ("specific_force", "angular_velocity")
            ]
        )
    return np.sqrt(np.mean(squares, axis=0))


# --- exact signals ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("earth", [None, EARTH])
@pytest.mark.parametrize(("rate_hz", "phase"), [(100.0, TURNING_POINT), (800.0, FULL_SPEED)])
def test_integrated_signals_of_a_slewing_shaking_cabin_return_its_true_state(earth, rate_hz, phase):
    position_m, attitude_deg = misses(rate_hz, earth, earth, vibration_m_s2=0.4, phase=phase)
    assert position_m < 0.01
    assert attitude_deg < 0.01


@pytest.mark.parametrize("earth", [None, EARTH])
def test_signals_are_exact_so_only_the_trapezoids_miss_and_fall_with_the_square_of_the_period(earth):
    coarse, fine, finest = (np.array(misses(rate, earth, earth)) for rate in (100.0, 200.0, 400.0))
    assert coarse / fine == pytest.approx([4.0, 4.0], rel=0.02)
    assert fine / finest == pytest.approx([4.0, 4.0], rel=0.02)
    assert finest[0] < 1e-4


def test_integration_that_leaves_out_the_earth_rate_goes_metres_astray():
    assert misses(100.0, EARTH, None)[0] > 1.0


def test_standing_imu_reads_gravity_and_the_earth_rate():
    rate, force = true_signals(standing(2), G, EARTH)
    assert rate @ TILT.T == pytest.approx(np.tile(EARTH, (2, 1)), abs=1e-18)
    assert np.linalg.norm(rate, axis=1) == pytest.approx(EARTH_RATE_RAD_S)
    assert force @ TILT.T == pytest.approx(np.tile([0.0, 0.0, G], (2, 1)), abs=1e-14)


def test_on_an_earth_that_stands_still_a_standing_imu_does_not_turn():
    rate, force = true_signals(standing(2), G, None)
    assert np.all(rate == 0.0)
    assert force @ TILT.T == pytest.approx(np.tile([0.0, 0.0, G], (2, 1)), abs=1e-14)


def test_who_goes_east_is_lighter_and_who_goes_north_is_held_to_the_west():
    """Eoetvoes' and Coriolis' effects at 10 m/s, by their textbook formulas."""
    sine, cosine = np.sin(np.radians(LATITUDE_DEG)), np.cos(np.radians(LATITUDE_DEG))
    _, east = true_signals(standing(1, np.eye(3), (10.0, 0.0, 0.0)), G, EARTH)
    _, north = true_signals(standing(1, np.eye(3), (0.0, 10.0, 0.0)), G, EARTH)
    pull = 2.0 * EARTH_RATE_RAD_S * 10.0
    assert east[0] == pytest.approx([0.0, pull * sine, G - pull * cosine], rel=1e-12)
    assert north[0] == pytest.approx([-pull * sine, 0.0, G], rel=1e-12)


def test_a_perfect_sheet_gives_the_true_signals_at_their_times():
    times = sample_times_s(100.0, 2.0)
    truth = slewing(times, 0.4)
    rate, force = true_signals(truth, G, EARTH)
    readings = sampled(imu(), truth, times, generator(1, "imu"), earth_rotation=True)
    assert np.array_equal(readings.times_s, times)
    assert readings.values["angular_velocity"] == pytest.approx(rate, abs=1e-15)
    assert readings.values["specific_force"] == pytest.approx(force, abs=1e-13)
    assert not readings.values["accelerometer_bias"].any() and not readings.values["gyroscope_bias"].any()


# --- noise and bias ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0])
def test_allan_deviation_at_one_second_is_the_white_density_at_every_rate(rate_hz):
    """Of the whole default datasheet; 5 seeds x 3 axes x 200 s leave 1.5 % of chance."""
    sheet = SimulatedImu(kind="imu", topic="/imu", frame="imu", rate_hz=rate_hz)
    half, one, two = (allan_over_seeds(sheet, 200.0, tau, seeds=5) for tau in (0.5, 1.0, 2.0))
    expected = [sheet.accelerometer_noise_density, sheet.gyroscope_noise_density]
    assert one == pytest.approx(expected, rel=0.1)
    assert np.log(two / half) / np.log(4.0) == pytest.approx([-0.5, -0.5], abs=0.05)


def test_allan_deviation_at_long_times_is_the_random_walk_density():
    """sigma = K sqrt(tau / 3); the seeds leave 1.5 % of chance and the white noise adds 0.2 %."""
    sheet = imu(
        10.0,
        accelerometer_noise_density=1e-3,
        accelerometer_random_walk=5e-4,
        gyroscope_noise_density=1e-4,
        gyroscope_random_walk=5e-5,
    )
    for tau_s in (60.0, 180.0):
        measured = allan_over_seeds(sheet, 6000.0, tau_s, seeds=20)
        assert measured / np.sqrt(tau_s / 3.0) == pytest.approx([5e-4, 5e-5], rel=0.1)


def test_reported_bias_is_what_a_reading_without_noise_is_wrong_by():
    sheet = imu(
        accelerometer_random_walk=1e-2,
        gyroscope_random_walk=1e-3,
        accelerometer_bias_sigma=0.03,
        gyroscope_bias_sigma=2e-3,
    )
    times = sample_times_s(100.0, 20.0)
    truth = slewing(times)
    rate, force = true_signals(truth, G, EARTH)
    readings = sampled(sheet, truth, times, generator(4, "imu"), earth_rotation=True)
    assert np.array_equal(readings.times_s, times)
    assert readings.values["gyroscope_bias"] == pytest.approx(readings.values["angular_velocity"] - rate, abs=1e-14)
    assert readings.values["accelerometer_bias"] == pytest.approx(readings.values["specific_force"] - force, abs=1e-13)
    assert np.ptp(readings.values["accelerometer_bias"], axis=0).min() > 1e-3


def test_bias_at_power_on_has_the_datasheets_sigma_and_then_walks_with_the_square_root_of_time():
    """300 runs x 3 axes leave 2.4 % of chance in a sigma."""
    sheet = imu(
        20.0,
        accelerometer_bias_sigma=0.03,
        gyroscope_bias_sigma=2e-3,
        accelerometer_random_walk=5e-5,
        gyroscope_random_walk=2e-6,
    )
    times = sample_times_s(20.0, 50.0 + 1e-9)
    runs = [sampled(sheet, standing(len(times)), times, generator(s, "imu")).values for s in range(300)]
    both = np.array([np.hstack([run["accelerometer_bias"], run["gyroscope_bias"]]) for run in runs])
    start, walked = both[:, 0], both[:, -1] - both[:, 0]
    for values, sigmas in ((start, [0.03, 2e-3]), (walked, np.array([5e-5, 2e-6]) * np.sqrt(50.0))):
        assert [values[:, :3].std(), values[:, 3:].std()] == pytest.approx(sigmas, rel=0.1)
        assert np.all(np.abs(values.mean(axis=0)) < 4.0 * np.repeat(sigmas, 3) / np.sqrt(300))
    correlation = np.corrcoef(np.hstack([start, walked]).T) - np.eye(12)
    assert np.abs(correlation).max() < 4.5 / np.sqrt(300)  # axes, sensors and times know nothing of each other


# --- scale, misalignment, range, resolution ---------------------------------------------------------------------------


def test_scale_and_misalignment_are_one_matrix_per_run_with_the_datasheets_sigmas():
    """200 runs x 3 scales or 6 angles leave 3 % and 2 % of chance."""
    sheet = imu(accelerometer_scale_sigma=1e-3, gyroscope_scale_sigma=4e-3, misalignment_sigma_rad=2e-3)
    times = sample_times_s(100.0, 1.0)
    truth = slewing(times)
    signals = true_signals(truth, G, None)
    errors = {"angular_velocity": [], "specific_force": []}
    for seed in range(200):
        readings = sampled(sheet, truth, times, generator(seed, "imu"))
        assert not readings.values["accelerometer_bias"].any() and not readings.values["gyroscope_bias"].any()
        for (name, found), signal in zip(errors.items(), signals, strict=True):
            solution = np.linalg.lstsq(signal, readings.values[name] - signal, rcond=None)[0]
            assert readings.values[name] == pytest.approx(signal + signal @ solution, abs=1e-12)
            found.append(solution.T)
    off_diagonal = ~np.eye(3, dtype=bool)
    for name, scale_sigma in (("angular_velocity", 4e-3), ("specific_force", 1e-3)):
        matrices = np.array(errors[name])
        assert matrices[:, ~off_diagonal].std() == pytest.approx(scale_sigma, rel=0.12)
        assert matrices[:, off_diagonal].std() == pytest.approx(2e-3, rel=0.1)
        assert np.abs(np.corrcoef(matrices.reshape(200, 9).T) - np.eye(9)).max() < 4.5 / np.sqrt(200)


def test_readings_are_multiples_of_the_resolution_and_nearest_to_the_truth():
    times = sample_times_s(100.0, 5.0)
    truth = slewing(times, 0.4)
    rate, force = true_signals(truth, G, None)
    sheet = imu(accelerometer_resolution=0.02, gyroscope_resolution=3e-3)
    values = sampled(sheet, truth, times, generator(1, "imu")).values
    for reading, signal, step in ((values["specific_force"], force, 0.02), (values["angular_velocity"], rate, 3e-3)):
        assert reading / step == pytest.approx(np.round(reading / step), abs=1e-9)
        assert np.abs(reading - signal).max() <= step / 2.0 + 1e-12
        assert len(np.unique(reading)) > 10


def test_readings_saturate_at_the_range_on_both_sides_and_never_pass_it():
    times = sample_times_s(100.0, 1.0)
    zero = np.zeros((len(times), 3))
    swing = np.sin(2.0 * np.pi * times)[:, None] * [1.0, 2.0, 0.1]
    truth = FrameMotion(np.tile(np.eye(3), (len(times), 1, 1)), zero, zero, 60.0 * swing, 6.0 * swing)
    rate, force = true_signals(truth, G, None)
    # 7.3 / 3e-3 is no whole number: rounding alone would pass the range
    sheet = imu(gyroscope_range=7.3, gyroscope_resolution=3e-3)
    values = sampled(sheet, truth, times, generator(1, "imu")).values
    for reading, signal, bound in ((values["specific_force"], force, 78.0), (values["angular_velocity"], rate, 7.3)):
        beyond = np.abs(signal) > bound + 0.01
        assert beyond.sum() > 10 and (~beyond).sum() > 100
        assert np.all(reading[beyond] == np.sign(signal[beyond]) * bound)
        assert np.abs(reading).max() == bound
        assert reading[~beyond] == pytest.approx(signal[~beyond], abs=0.01)


# --- random numbers ---------------------------------------------------------------------------------------------------


def whole_imu(seed=3, **changes):
    sheet = SimulatedImu(kind="imu", topic="/imu", frame="imu", rate_hz=100.0, **changes)
    times = sample_times_s(100.0, 3.0)
    readings = sampled(sheet, slewing(times), times, generator(seed, "imu"), earth_rotation=True)
    return [
        readings.values["specific_force"],
        readings.values["angular_velocity"],
        readings.values["accelerometer_bias"],
        readings.values["gyroscope_bias"],
    ]


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    first, again, other = whole_imu(3), whole_imu(3), whole_imu(4)
    assert [a.tobytes() for a in first] == [a.tobytes() for a in again]
    assert all(not np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_switching_one_error_off_leaves_the_others_as_they_were():
    with_noise = whole_imu(accelerometer_resolution=0.0)
    without = whole_imu(accelerometer_resolution=0.0, accelerometer_noise_density=0.0)
    assert not np.array_equal(with_noise[0], without[0])
    assert all(np.array_equal(a, b) for a, b in zip(with_noise[1:], without[1:], strict=True))
    assert (with_noise[0] - without[0]).std() == pytest.approx(1e-3 * np.sqrt(100.0), rel=0.15)


def test_every_error_of_the_datasheet_reaches_the_readings():
    ignored = {"kind", "topic", "frame", "rate_hz", "transport", "clock", "accelerometer_range", "gyroscope_range"}
    plain = whole_imu()
    for name in SimulatedImu.model_fields.keys() - ignored:
        changed = whole_imu(**{name: 0.0})
        expected = {"accelerometer": [0], "gyroscope": [1]}.get(name.split("_")[0], [0, 1])
        assert [k for k in (0, 1) if not np.array_equal(plain[k], changed[k])] == expected, name
