"""A machine that travels in one direction of its own is told by its course how it heads, another one is not."""

import gtsam
import numpy as np
import pytest
from motion import ns

from holdfast.estimator.travel_direction import TravelDirection
from holdfast.sensors.sensor import Velocity
from holdfast.state import OptimisedState

LEVEL = gtsam.Rot3()


def state(t, yaw_rad, course_rad, *, speed_m_s=5.0, sigma_rad=0.01, mount=LEVEL):
    velocity = speed_m_s * np.array([np.cos(course_rad), np.sin(course_rad), 0.0])
    nav = gtsam.NavState(gtsam.Rot3.Yaw(yaw_rad).compose(mount), np.zeros(3), velocity)
    covariance = np.eye(15) * sigma_rad**2
    return OptimisedState(ns(t), nav, gtsam.imuBias.ConstantBias(), covariance, np.zeros(3))


def learnt(courses, **how):
    travel = TravelDirection()
    for k, course_rad in enumerate(courses):
        travel.note(state(0.5 * k, 0.1 * k, 0.1 * k + course_rad, **how))
    return travel


def towards(course_rad, speed_m_s=5.0, sigma_m_s=0.1):
    velocity = speed_m_s * np.array([np.cos(course_rad), np.sin(course_rad), 0.0])
    return Velocity(ns(0.0), "doppler", velocity, np.eye(3) * sigma_m_s**2)


MOUNTS = pytest.mark.parametrize("mount", [LEVEL, gtsam.Rot3.RzRyRx(1.5, 0.2, -0.4), gtsam.Rot3.Pitch(1.55)])


@MOUNTS
@pytest.mark.parametrize("off_rad", [0.0, 1.2, np.pi])
def test_the_course_tells_by_how_much_an_attitude_is_beside_it_however_the_imu_is_mounted(mount, off_rad):
    travel = learnt([off_rad] * 40, mount=mount)
    attitude = gtsam.Rot3.Yaw(2.0).compose(mount)
    assert travel.turned_beside(attitude, towards(2.0 + off_rad + 0.7)) == pytest.approx(0.7, abs=1e-6)
    assert travel.turned_beside(attitude, towards(2.0 + off_rad - 3.0)) == pytest.approx(-3.0, abs=1e-6)


def test_a_machine_that_swings_round_its_axle_still_has_a_direction():
    rng = np.random.default_rng(3)
    travel = learnt(rng.normal(0.0, 0.25, 60))
    assert travel.turned_beside(gtsam.Rot3(), towards(1.0)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    "travel",
    [
        learnt([0.0, np.pi] * 30),  # goes forth and back
        learnt(np.linspace(0.0, 20.0, 60)),  # a cabin that slews
        learnt([0.0] * 60, speed_m_s=0.5),  # slow
        learnt([0.0] * 60, sigma_rad=0.2),  # of an attitude that is vague itself
        learnt([0.0] * 5),  # for two seconds only
        TravelDirection(),
    ],
)
def test_one_that_goes_all_ways_or_hardly_at_all_is_not_told(travel):
    assert travel.turned_beside(gtsam.Rot3(), towards(1.0)) is None


def test_a_slow_one_has_no_course():
    travel = learnt([0.0] * 60)
    assert travel.turned_beside(gtsam.Rot3(), towards(1.0, speed_m_s=0.5)) is None
    assert travel.turned_beside(gtsam.Rot3(), towards(1.0, speed_m_s=3.0, sigma_m_s=1.0)) is None
