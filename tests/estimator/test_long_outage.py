"""Minutes of nothing but an IMU: the estimate stays one, and comes back with the fixes."""

from dataclasses import replace

import numpy as np
import pytest
from motion import Drive, deviation, estimates, fixes, imu, in_order, machine, ns, run
from rig import SIGMAS, smoother_of, truth

from holdfast.config.model import GateConfig
from holdfast.estimator.plausible_speed import PlausibleSpeed
from holdfast.events import EventKind, Health

LOST_S, BACK_S, END_S = 6.0, 80.0, 95.0
RIGHT_S = 88.0  # five seconds after the accelerometer is right again


def recorded(rises_m_s2, until_s):
    """GNSS is lost for long, and the accelerometer reads too much for a part of it."""
    rng, drive = np.random.default_rng(5), Drive()
    samples = [
        replace(one, specific_force=one.specific_force + np.array([0.0, 0.0, rises_m_s2]))
        if ns(LOST_S + 2.0) < one.stamp_ns < ns(until_s)
        else one
        for one in imu(drive, 0.0, END_S, 50.0, rng)
    ]
    antenna = [one for one in fixes(drive, 0.0, END_S, 5.0, rng) if not ns(LOST_S) < one.stamp_ns < ns(BACK_S)]
    return drive, in_order(samples, antenna)


@pytest.mark.parametrize("until_s", [BACK_S - 5.0, BACK_S + 3.0], ids=["before the fixes come", "until after it"])
def test_an_estimate_that_has_run_away_comes_back_with_the_fixes(until_s):
    """It reaches the speed beyond which nothing is a solution, so that the graph begins anew there again and again."""
    drive, messages = recorded(rises_m_s2=20.0, until_s=until_s)
    estimator, outputs = run(machine(lidar=False), messages)
    assert any("the speed is" in one.reason for one in estimator.events if one.kind is EventKind.OPTIMISER_FAULT)
    published = estimates(outputs)
    assert published[-1].stamp_ns - published[0].stamp_ns > (END_S - 5.0) * 1e9
    assert estimator.health is Health.NOMINAL
    assert max(deviation(drive, one)[0] for one in published if one.stamp_ns > ns(RIGHT_S)) < 1.0


def vague(sigma_m_s):
    """A smoother at the start, with a velocity that is so uncertain."""
    sigmas = SIGMAS.copy()
    sigmas[6:9] = sigma_m_s
    return smoother_of(Drive(), 1.0, state=truth(Drive(), 0.0, sigmas))


@pytest.mark.parametrize(("sigma_m_s", "is_told"), [(5.0, False), (19.0, False), (60.0, True)])
def test_a_velocity_is_told_to_be_that_of_a_machine_where_it_is_known_worse(sigma_m_s, is_told):
    smoother = vague(sigma_m_s)
    PlausibleSpeed(GateConfig()).add_to([smoother])
    most = float(np.sqrt(smoother.optimise().covariance.diagonal()[6:9].max()))
    assert most == pytest.approx((sigma_m_s**-2 + is_told * 20.0**-2) ** -0.5, rel=0.02)


def test_it_is_told_to_both_graphs_once_a_second_at_most():
    pair, speed = [vague(60.0), vague(60.0)], PlausibleSpeed(GateConfig())
    speed.add_to(pair)
    assert [one.optimise().covariance.diagonal()[6:9].max() < 400.0 for one in pair] == [True, True]
    speed.add_to(pair)
    assert [len(one.measured(0, one.newest_ns)) for one in pair] == [1, 1]
