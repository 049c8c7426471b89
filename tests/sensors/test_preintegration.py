"""Preintegration against motion in closed form: the only error is that of the step, and cutting costs nothing."""

import itertools

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion import Drive, G, apart, imu, machine, ns, tilted_circle
from numeric import assert_jacobians, residual

from holdfast.config.model import MotionModelConfig
from holdfast.sensors import preintegration
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import CALM, ImuNoise, MotionModel, integrate, preintegrate

CONFIG = machine().imu
NO_BIAS = gtsam.imuBias.ConstantBias()
NOISE = ImuNoise(CONFIG, 1e-4, G)
DRIVING = Drive(start_s=-3.0)
# GTSAM adds rotations in the tangent space at the start of an interval: off by dt / 12 |w|^2 times the part of the one
# that is not about the axis of w, which in 1 s of this drive is below 0.25 rad, at |w| < 1.1 rad/s
CONING = 1.0 / 12.0 * 1.1**2 * 0.25


def filled(motion, start_s, end_s, hz, **how):
    buffer = ImuBuffer(CONFIG)
    for sample in imu(motion, start_s, end_s, hz, **how):
        buffer.add(sample)
    return buffer


def carried(buffer, nav, cuts_s, bias=NO_BIAS):
    """Carry a state from cut to cut."""
    for start, end in itertools.pairwise(cuts_s):
        nav = preintegrate(buffer.steps(ns(start), ns(end)), NOISE, nav.attitude(), bias).predict(nav, bias)
    return nav


@pytest.mark.parametrize("hz", [100.0, 200.0])
def test_ten_seconds_of_constant_twist_leave_only_the_error_of_the_step(hz):
    motion = tilted_circle()
    buffer = filled(motion, 0.0, 10.0, hz)
    position, rotation, velocity = apart(carried(buffer, motion.nav(0.0), np.arange(0.0, 10.5, 0.5)), motion.nav(10.0))
    # a constant rate is integrated exactly; the specific force, seen in W, is integrated by the midpoint and read
    # by the trapezium: dt^2 (1/24 + 1/12) of its second derivative, which is |f| w^2 at most
    acceleration = 1.0**2 * (G + 1.5) / 8.0 / hz**2
    assert rotation < 1e-9
    assert velocity < acceleration * 10.0
    assert position < acceleration * 10.0**2 / 2.0


def test_attitude_follows_a_wobbling_turn_to_second_order():
    motion = DRIVING
    cuts = np.arange(0.0, 10.5, 0.5)
    for hz in (100.0, 200.0):
        _, rotation, _ = apart(carried(filled(motion, 0.0, 10.0, hz), motion.nav(0.0), cuts), motion.nav(10.0))
        # trapezium and coning: dt^2 / 12 (|w''| + |w x w'|) with |w'| < 0.45, |w''| < 0.5 rad/s^3 on this drive
        assert rotation < 10.0 / 12.0 / hz**2 * (0.5 + 1.1 * 0.45)


@given(st.lists(st.integers(1, 999).map(lambda ms: ms / 1000.0 + 1e-7), min_size=1, max_size=6, unique=True))
@settings(max_examples=50, deadline=None)
def test_cutting_an_interval_anywhere_gives_the_motion_of_the_whole(cuts):
    motion, hz = DRIVING, 200.0
    buffer = filled(motion, 0.0, 1.0, hz)
    whole = carried(buffer, motion.nav(0.0), [0.0, 1.0])
    position, rotation, velocity = apart(whole, carried(buffer, motion.nav(0.0), [0.0, *sorted(cuts), 1.0]))
    # a cut replaces the mean over one step by the means over its parts: f' dt^2 / 4 of velocity, and half a step of
    # rotation: |w x f| dt^2 / 4
    per_cut = 1.0 / hz**2 / 4.0 * 2.0 * G
    assert rotation < CONING / hz
    assert velocity < len(cuts) * per_cut + CONING / hz * G
    assert position < len(cuts) * per_cut + CONING / hz * G / 2.0


def test_cutting_at_a_sample_changes_nothing():
    buffer = filled(DRIVING, 0.0, 1.0, 200.0)
    whole = carried(buffer, DRIVING.nav(0.0), [0.0, 1.0])
    position, rotation, velocity = apart(whole, carried(buffer, DRIVING.nav(0.0), [0.0, 0.4, 1.0]))
    assert rotation < CONING / 200.0
    assert velocity < CONING / 200.0 * G
    assert position < CONING / 200.0 * G / 2.0


def test_a_steady_reading_gives_steady_steps_that_fill_the_interval():
    buffer = filled(tilted_circle(), 0.0, 1.0, 100.0, phase_s=0.0031)
    steps = buffer.steps(ns(0.1), ns(0.777))
    assert sum(step.dt_s for step in steps) == pytest.approx(0.677, abs=1e-12)
    assert all(step.dt_s <= 0.01 + 1e-12 for step in steps)
    for step in steps:
        np.testing.assert_allclose(step.angular_velocity, tilted_circle().readings(0.0)[1], atol=1e-12)


def test_bias_is_taken_from_the_readings():
    bias = gtsam.imuBias.ConstantBias(np.array([0.1, -0.2, 0.05]), np.array([0.01, 0.02, -0.005]))
    clean = carried(filled(DRIVING, 0.0, 1.0, 100.0), DRIVING.nav(0.0), [0.0, 0.3, 1.0])
    biased = carried(filled(DRIVING, 0.0, 1.0, 100.0, bias=bias.vector()), DRIVING.nav(0.0), [0.0, 0.3, 1.0], bias)
    assert max(apart(clean, biased)) < 1e-9


def test_noise_of_preintegration_is_that_of_its_densities():
    steps = filled(DRIVING, 0.0, 1.0, 100.0).steps(ns(0.0), ns(1.0))
    covariance = preintegrate(steps, NOISE, DRIVING.nav(0.0).attitude(), NO_BIAS).preintMeasCov()
    # in the tangent space noise across a rotation of 1 rad counts (0.5 / sin 0.5)^2 = 1.09 times
    # white noise over 1 s: rotation N_g, velocity N_a and (force 9.8 turned by a random walk) g N_g / sqrt(3)
    np.testing.assert_allclose(np.diag(covariance)[:3], 2e-4**2, rtol=0.1)
    up = np.hypot(2e-3, G * 2e-4 / np.sqrt(3.0))
    assert np.diag(covariance)[6:].min() > 2e-3**2 * 0.95 and np.diag(covariance)[6:].max() < up**2 * 1.3
    assert np.linalg.matrix_rank(covariance, tol=1e-14) == 9


def test_one_sample_gives_a_covariance_of_full_rank():
    (step,) = filled(DRIVING, 0.0, 0.01, 100.0).steps(ns(0.0), ns(0.01))
    covariance = preintegrate([step], NOISE, DRIVING.nav(0.0).attitude(), NO_BIAS).preintMeasCov()
    scale = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > 1e-6


def test_motion_makes_the_noise_grow_in_proportion_and_rest_does_not():
    moving = ImuNoise(machine(imu_={"accelerometer_error_ratio": 0.02, "gyroscope_error_ratio": 0.01}).imu, 1e-4, G)
    R = gtsam.Rot3.RzRyRx(0.1, 0.2, 0.3)
    up = R.unrotate(np.array([0.0, 0.0, G]))
    at_rest = moving.params(up, np.zeros(3), R, CALM)
    np.testing.assert_allclose(np.sqrt(np.diag(at_rest.getAccelerometerCovariance())), 2e-3, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(at_rest.getGyroscopeCovariance())), 2e-4, rtol=1e-9)
    turning = moving.params(up + np.array([0.0, 1.5, 0.0]), np.array([0.0, 0.0, 1.0]), R, CALM)
    np.testing.assert_allclose(np.sqrt(np.diag(turning.getAccelerometerCovariance())), np.hypot(2e-3, 0.03), rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(turning.getGyroscopeCovariance())), np.hypot(2e-4, 0.01), rtol=1e-9)


# --- the motion model that stands in for a silent IMU -----------------------------------------------------------------


def coasted(duration_s, motion=None, bias=NO_BIAS, start_s=0.7):
    motion = motion or tilted_circle()
    model = MotionModel(MotionModelConfig(), G)
    nav = motion.nav(start_s)
    return nav, model.preintegrate(duration_s, nav, motion.readings(start_s)[1], bias)


@pytest.mark.parametrize("duration_s", [0.013, 0.3, 1.5])
def test_the_motion_model_goes_on_with_a_constant_twist(duration_s):
    motion = tilted_circle()
    nav, pim = coasted(duration_s)
    position, rotation, velocity = apart(pim.predict(nav, NO_BIAS), motion.nav(0.7 + duration_s))
    # steps of 20 ms with constant acceleration, at 1.5 m/s and 1 rad/s: midpoint rule for the velocity, and a local
    # error of dt^3 / 12 times the jerk for the position
    assert rotation < 1e-9
    assert velocity < 0.02**2 / 24.0 * 1.5 * duration_s + 1e-9
    assert position < 0.02**2 * 1.5 * (duration_s / 12.0 + duration_s**2 / 48.0) + 1e-9


def test_a_long_silence_takes_no_more_steps_than_a_short_one(monkeypatch):
    """3600 s took 180000 steps; at most 100 follow the twist of ten seconds within a hundredth of its uncertainty."""
    steps = []
    monkeypatch.setattr(preintegration, "integrate", lambda *step: steps.append(step) or integrate(*step))
    for duration_s in (1.99, 10.0, 3600.0):
        steps.clear()
        nav, pim = coasted(duration_s)
        assert len(steps) <= 100
        assert pim.deltaTij() == pytest.approx(duration_s)
        position, _, _ = apart(pim.predict(nav, NO_BIAS), tilted_circle().nav(0.7 + duration_s))
        sigma_m = MotionModelConfig().acceleration_density * np.sqrt(duration_s**3 / 3.0)
        assert position < 0.01 * sigma_m or duration_s > 10.0  # which is begun anew after


def test_the_motion_model_does_not_depend_on_the_bias():
    bias = gtsam.imuBias.ConstantBias(np.array([0.3, -0.2, 0.1]), np.array([0.02, 0.01, -0.03]))
    nav, plain = coasted(1.0)
    _, biased = coasted(1.0, bias=bias)
    assert max(apart(plain.predict(nav, NO_BIAS), biased.predict(nav, bias))) < 1e-9


@pytest.mark.parametrize("duration_s", [0.1, 0.5, 1.5])
def test_the_motion_model_is_as_unsure_as_white_acceleration_and_turning_make_it(duration_s):
    standing = Drive(start_s=100.0)
    config = MotionModelConfig()
    _, pim = coasted(duration_s, standing)
    sigma = np.sqrt(np.diag(pim.preintMeasCov()))
    rotation = config.angular_rate_density * np.sqrt(duration_s)
    np.testing.assert_allclose(sigma[:3], rotation, rtol=0.05)
    # along gravity white acceleration alone; across it the tilt turns gravity into acceleration as well
    fall = gtsam.Rot3.RzRyRx(0.05, -0.08, 0.3).unrotate(np.array([0.0, 0.0, 1.0]))
    along_velocity = np.sqrt(fall @ pim.preintMeasCov()[6:9, 6:9] @ fall)
    along_position = np.sqrt(fall @ pim.preintMeasCov()[3:6, 3:6] @ fall)
    white = config.acceleration_density
    assert along_velocity == pytest.approx(white * np.sqrt(duration_s), rel=0.05)
    floor = 0.1 * np.sqrt(duration_s)  # its own position noise
    assert along_position == pytest.approx(np.hypot(white * np.sqrt(duration_s**3 / 3.0), floor), rel=0.1)


@pytest.mark.parametrize("is_gap", [False, True])
def test_the_factor_of_a_motion_has_the_jacobians_that_it_claims(is_gap):
    motion = tilted_circle()
    i, j, b = gtsam.symbol("x", 0), gtsam.symbol("x", 1), gtsam.symbol("b", 0)
    if is_gap:
        nav, pim = coasted(0.4)
    else:
        nav = motion.nav(0.2)
        pim = preintegrate(filled(motion, 0.0, 1.0, 100.0).steps(ns(0.2), ns(0.6)), NOISE, nav.attitude(), NO_BIAS)
    factor = gtsam.ImuFactor2(i, j, b, pim)
    values = gtsam.Values()
    values.insert(i, nav)
    values.insert(j, pim.predict(nav, NO_BIAS))
    values.insert(b, NO_BIAS)
    np.testing.assert_allclose(residual(factor, values), np.zeros(9), atol=1e-6)
    rng = np.random.default_rng(1)
    values.update(j, values.atNavState(j).retract(rng.normal(0.0, 0.02, 9)))
    values.update(i, values.atNavState(i).retract(rng.normal(0.0, 0.02, 9)))
    assert_jacobians(factor, values, 1e-5)
