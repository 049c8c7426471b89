"""Which velocities are left out: those that lead elsewhere than the positions, or fit to them much better otherwise."""

import numpy as np
import pytest
from motion import Drive, ns

from holdfast.estimator.velocity_check import VelocityCheck
from holdfast.sensors.sensor import Position, Velocity

ROAD = Drive(start_s=0.0, ramp_s=4.0, radius_m=30.0, speed=0.25, tilt=0.0, heave_m=0.0)  # 7.5 m/s
STILL = Drive(start_s=1e3)
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


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
    check = VelocityCheck()
    check.review(velocities(5.0, 35.0, late_s), positions(5.0, 35.0, claim=3.0))
    assert check.lying == {"doppler"}
    credible, lying = VelocityCheck().credible(velocities(5.0, 35.0, late_s), positions(5.0, 35.0, claim=3.0))
    assert credible == [] and lying == ["doppler"]


@pytest.mark.parametrize("axes", [-np.eye(3), NED])
def test_velocities_in_other_axes_are_left_out_though_the_fixes_claim_too_little_to_miss_them(axes):
    check = VelocityCheck()
    check.review(velocities(5.0, 35.0, axes=axes), positions(5.0, 35.0, claim=30.0))
    assert check.lying == {"doppler"}


@pytest.mark.parametrize("sigma", [0.02, 0.5, 3.0])
@pytest.mark.parametrize("late_s", [0.0, 0.2])
def test_good_velocities_are_believed_whatever_the_fixes_are_worth(sigma, late_s):
    for seed in range(20):
        check = VelocityCheck()
        sent = velocities(5.0, 35.0, late_s), positions(5.0, 35.0, sigma, sigma, seed=seed)
        check.look_back(*sent)
        check.review(*sent)
        assert check.credible(*sent) == (sent[0], [])


def test_what_led_elsewhere_is_believed_again_once_it_leads_where_the_positions_do_through_a_turn():
    check = VelocityCheck()
    check.look_back(velocities(5.0, 35.0, axes=-np.eye(3)), positions(5.0, 35.0, 0.02, 0.02))
    assert check.lying == {"doppler"}
    check.review(velocities(5.0, 35.0, road=STILL), positions(5.0, 35.0, 0.02, 0.02, road=STILL))
    assert check.lying == {"doppler"}  # who stands proves nothing
    check.review(velocities(40.0, 70.0), positions(40.0, 70.0, 0.02, 0.02))
    assert check.lying == set()
