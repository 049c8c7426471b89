"""Which velocities are left out: those that lead elsewhere than the positions, or fit to them much better otherwise."""

from dataclasses import replace
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest
from motion import Drive, ns

from holdfast.estimator.velocity_check import Company, VelocityCheck
from holdfast.sensors.sensor import Position, Velocity

ROAD = Drive(start_s=0.0, ramp_s=4.0, radius_m=30.0, speed=0.25, tilt=0.0, heave_m=0.0)  # 7.5 m/s
STILL = Drive(start_s=1e3)
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def begun(receiver=(0.0, 0.0, 2.0), sensor=(0.0, 0.0, 2.0)):
    at = {"gnss": SimpleNamespace(p_I_P=np.array(receiver))}
    return VelocityCheck(at, {"doppler": SimpleNamespace(p_I_P=np.array(sensor))})


def positions(start_s, end_s, sigma=0.0, claim=1.0, *, seed=1, road=ROAD):
    rng = np.random.default_rng(seed)
    times = np.arange(start_s, end_s, 1.0)
    return [
        Position(ns(t), "gnss", road.nav(t).position() + rng.normal(0.0, sigma, 3), np.eye(3) * claim**2, 0.0)
        for t in times
    ]


def velocities(start_s, end_s, late_s=0.0, *, axes=None, sigma=0.05, road=ROAD):
    rng, R = np.random.default_rng(2), np.eye(3) if axes is None else axes
    times = np.arange(start_s, end_s, 0.2)
    return [
        Velocity(ns(t), "doppler", R @ road.nav(t - late_s).velocity() + rng.normal(0.0, sigma, 3), np.eye(3) * 0.01)
        for t in times
    ]


@pytest.mark.parametrize("late_s", [-1.0, 1.0, 1.4])
def test_velocities_that_are_late_are_left_out_though_the_fixes_claim_too_little_to_miss_them(late_s):
    check = begun()
    check.review(velocities(5.0, 35.0, late_s), positions(5.0, 35.0, claim=3.0), ns(35.0))
    assert check.lying == {"doppler"}
    assert begun().erring(velocities(5.0, 35.0, late_s), positions(5.0, 35.0, claim=3.0)) == ["doppler"]


@pytest.mark.parametrize("axes", [-np.eye(3), NED])
def test_velocities_in_other_axes_are_left_out_though_the_fixes_claim_too_little_to_miss_them(axes):
    check = begun()
    check.review(velocities(5.0, 35.0, axes=axes), positions(5.0, 35.0, claim=30.0), ns(35.0))
    assert check.lying == {"doppler"}


@pytest.mark.parametrize("sigma", [0.02, 0.5, 3.0])
@pytest.mark.parametrize("late_s", [0.0, 0.2])
def test_good_velocities_are_believed_whatever_the_fixes_are_worth(sigma, late_s):
    for seed in range(20):
        check = begun()
        sent = velocities(5.0, 35.0, late_s), positions(5.0, 35.0, sigma, sigma, seed=seed)
        check.look_back(*sent)
        check.review(*sent, ns(35.0))
        assert check.lying == set() and check.erring(*sent) == []


def test_what_led_elsewhere_is_believed_again_once_it_leads_where_the_positions_do_through_a_turn():
    check = begun()
    check.look_back(velocities(5.0, 35.0, axes=-np.eye(3)), positions(5.0, 35.0, 0.02, 0.02))
    assert check.lying == {"doppler"}
    check.review(velocities(5.0, 35.0, road=STILL), positions(5.0, 35.0, 0.02, 0.02, road=STILL), ns(35.0))
    assert check.lying == {"doppler"}  # who stands proves nothing
    check.review(velocities(40.0, 70.0), positions(40.0, 70.0, 0.02, 0.02), ns(70.0))
    assert check.lying == set()


def test_velocities_of_another_point_of_the_machine_are_not_judged_by_where_this_one_goes():
    """Antennas on opposite sides of a cabin that slews go opposite ways."""
    check, sent = begun(sensor=(0.0, -2.0, 2.0)), (velocities(5.0, 35.0, axes=-np.eye(3)), positions(5.0, 35.0, 0.02))
    check.look_back(*sent)
    check.review(*sent, ns(35.0))
    assert check.lying == set() and check.erring(*sent) == []
    assert begun().erring(*sent) == ["doppler"]


def test_velocities_confirm_positions_against_an_estimate_that_is_elsewhere():
    sent, now = (velocities(25.0, 35.0), positions(25.0, 35.0, 0.1, 0.1)), ROAD.nav(34.0)
    there = gtsam.NavState(now.attitude(), now.position() - np.array([0.0, 0.0, 2.0]), now.velocity())
    off = gtsam.NavState(now.attitude(), now.position() + np.array([12.0, 0.0, 0.0]), now.velocity())
    assert begun().confirms(*sent, ns(33.0), off)
    assert not begun().confirms(*sent, ns(33.0), there)
    backwards = velocities(25.0, 35.0, axes=-np.eye(3))
    assert not begun().confirms(backwards, sent[1], ns(33.0), off)


def test_velocities_that_have_proven_right_stand_against_fixes_that_wander():
    rng, check = np.random.default_rng(3), begun()
    fixes = positions(5.0, 45.0, 0.1, 0.5)
    wander = np.cumsum(rng.normal(0.0, 4.0, (len(fixes), 3)), axis=0)
    astray = [replace(one, p_W_P=one.p_W_P + off) for one, off in zip(fixes, wander, strict=True)]
    assert check.company(velocities(5.0, 45.0), astray, ns(35.0)) is Company.UNKNOWN  # nothing has proven them
    check.review(velocities(5.0, 35.0), positions(5.0, 35.0, 0.1, 0.5), ns(35.0))
    assert check.proven == {"doppler"}
    assert check.company(velocities(5.0, 45.0), astray, ns(35.0)) is Company.ASTRAY
    assert check.company(velocities(5.0, 45.0), fixes, ns(35.0)) is Company.BESIDE
    beside = [replace(one, p_W_P=one.p_W_P + 30.0) for one in fixes]
    assert check.company(velocities(5.0, 45.0), beside, ns(35.0)) is Company.BESIDE  # a place is no way


def test_a_way_that_is_shorter_than_the_noise_of_the_fixes_tells_nothing():
    check = begun()
    check.review(velocities(5.0, 35.0), positions(5.0, 35.0, 0.1, 0.5), ns(35.0))
    standing = velocities(40.0, 55.0, road=STILL), positions(40.0, 55.0, 0.1, 0.5, road=STILL)
    assert check.company(*standing, ns(45.0)) is Company.UNKNOWN
    frozen = [replace(one, p_W_P=ROAD.nav(35.0).position()) for one in positions(35.0, 50.0)]
    assert check.company(velocities(35.0, 50.0), frozen, ns(40.0)) is Company.ASTRAY
