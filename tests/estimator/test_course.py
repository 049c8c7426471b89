"""Where the positions of one receiver lead: its place and velocity, and how far that is known."""

import numpy as np
import pytest
from motion import ns

from holdfast.estimator.course import UNKNOWN_VARIANCE, course_of
from holdfast.sensors.sensor import Position, Velocity

ARM = np.array([0.4, -0.5, 1.2])
SPEED = np.array([3.0, -1.0, 0.2])


def positions(times, sigma_m=0.1, rng=None, acceleration=(0.0, 0.0, 0.0)):
    found = []
    for t in times:
        noise = np.zeros(3) if rng is None else rng.normal(0.0, sigma_m, 3)
        p = SPEED * t + 0.5 * np.array(acceleration) * t**2 + noise
        found.append(Position(ns(t), "gnss", p, np.eye(3) * sigma_m**2, 0.0))
    return found


def doppler(t, velocity, sigma=0.05):
    return Velocity(ns(t), "doppler", np.array(velocity), np.eye(3) * sigma**2)


def test_fewer_than_two_positions_lead_nowhere_without_a_velocity():
    assert course_of([], [doppler(0.5, SPEED)], ns(1.0), ARM) is None
    assert course_of(positions([0.5]), [], ns(1.0), ARM) is None
    led = course_of(positions([0.5]), [doppler(0.5, SPEED)], ns(1.0), ARM)
    assert np.allclose(led.p_W_P, positions([1.0])[0].p_W_P) and np.allclose(led.v_W_P, SPEED)


def test_it_is_carried_on_to_the_time_that_is_asked_for():
    course = course_of(positions([0.0, 1.0, 2.0]), [], ns(2.5), ARM)
    np.testing.assert_allclose(course.p_W_P, 2.5 * SPEED, atol=1e-9)
    np.testing.assert_allclose(course.v_W_P, SPEED, atol=1e-9)
    assert course.p_I_P is ARM
    assert np.trace(course.of_position) > 3.0 * 0.1**2  # more than one position


def test_a_measured_velocity_goes_before_that_of_a_line():
    course = course_of(positions([0.0, 1.0, 2.0]), [doppler(1.0, SPEED), doppler(2.0, 2.0 * SPEED)], ns(2.0), ARM)
    np.testing.assert_allclose(course.v_W_P, 2.0 * SPEED)
    np.testing.assert_allclose(course.of_velocity, np.eye(3) * 0.05**2)


def test_a_velocity_that_was_not_measured_on_all_axes_does_not():
    flat = Velocity(ns(2.0), "doppler", np.zeros(3), np.diag([0.01, 0.01, 2.0 * UNKNOWN_VARIANCE]))
    course = course_of(positions([0.0, 1.0, 2.0]), [flat], ns(2.0), ARM)
    np.testing.assert_allclose(course.v_W_P, SPEED, atol=1e-9)


@pytest.mark.parametrize("acceleration", [(0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (0.0, -1.5, 0.0)])
@pytest.mark.parametrize("sigma_m", [0.01, 0.5])
def test_errors_are_within_three_of_its_sigmas(sigma_m, acceleration):
    times, now = np.arange(0.0, 2.05, 0.2), 2.3
    for seed in range(20):
        course = course_of(positions(times, sigma_m, np.random.default_rng(seed), acceleration), [], ns(now), ARM)
        v = SPEED + np.array(acceleration) * now
        p = SPEED * now + 0.5 * np.array(acceleration) * now**2
        assert (abs(course.v_W_P - v) < 3.5 * np.sqrt(np.diag(course.of_velocity))).all()
        assert (abs(course.p_W_P - p) < 3.5 * np.sqrt(np.diag(course.of_position))).all()
