"""Biases that are not what was known of them: wrong from the beginning, or from some time on, which is found."""

from dataclasses import replace

import numpy as np
import pytest
from motion import ARM, Drive, G, imu, machine, ns
from rig import NO_BIAS, buffered, position

from holdfast.graph.alignment import BatchAligner
from holdfast.graph.alignment_problem import BiasPrior, Evidence, Problems
from holdfast.sensors.preintegration import ImuNoise
from holdfast.sensors.registry import sensors_of

CONFIG = machine()
KNOWN, DOUBTED = np.repeat([0.1, 2e-3], 3), np.repeat([0.1, 0.03], 3)
ROAD = Drive(start_s=-4.0, radius_m=20.0, speed=0.3, tilt=0.0, heave_m=0.0)  # 6 m/s
HILLS = Drive(start_s=4.0, ramp_s=4.0, radius_m=20.0, speed=0.3)  # its attitude and speed change
END_S, AXIS = 30.0, np.array([0.6, 0.0, 0.8])


def aligned(
    at_s, by_deg_s, *, by_m_s2=0.0, known=KNOWN, claim_m=0.3, noise_m=0.3, jump_sigmas=DOUBTED, seed=0, motion=ROAD
):
    """The batch of 30 s in which the biases jump; positions every second."""
    rng, by, by_force = np.random.default_rng(seed), np.radians(by_deg_s) * AXIS, by_m_s2 * AXIS
    samples = [
        replace(one, angular_velocity=one.angular_velocity + by, specific_force=one.specific_force + by_force)
        if one.stamp_ns > ns(at_s)
        else one
        for one in imu(motion, 0.0, END_S + 0.1, 100.0, rng)
    ]
    noise = ImuNoise(CONFIG.imu, CONFIG.graph.position_integration_sigma, G)
    buffer = buffered(motion, END_S, samples=samples)
    aligner = BatchAligner(Problems(buffer, noise, {"gnss": sensors_of(CONFIG)["gnss"]}, {}))
    times = np.arange(0.5, END_S, 1.0)
    fixes = [position(motion, t, ARM, rng.normal(0.0, noise_m, 3), sigma_m=claim_m) for t in times]
    return aligner.solve(Evidence(fixes, []), BiasPrior(NO_BIAS, known), np.radians(30.0), jump_sigmas)


@pytest.mark.parametrize(("at_s", "by_deg_s"), [(18.3, 2.0), (22.0, 3.0), (12.0, 1.0)])
def test_it_is_found_where_it_is_and_as_large_as_it_is(at_s, by_deg_s):
    found = aligned(at_s, by_deg_s)
    assert found.jump.is_believed
    assert abs(found.jump.stamp_ns - ns(at_s)) < 1.5e9
    off = found.state.bias.gyroscope() - np.radians(by_deg_s) * AXIS
    of_bias = found.state.covariance[12:, 12:]
    assert off @ np.linalg.solve(of_bias, off) < 14.2  # 3 sigma of three numbers
    # about the vertical less is seen, and what is not seen is not believed
    assert 0.6 * by_deg_s < np.degrees(found.jump.by_rad_s) < 1.2 * by_deg_s


def test_the_state_after_it_is_as_sure_as_it_is_right():
    found = aligned(20.0, 2.0)
    truth = ROAD.nav((found.state.stamp_ns - ns(0.0)) * 1e-9)
    error = found.state.nav.localCoordinates(truth)
    assert error @ np.linalg.solve(found.state.covariance[:9, :9], error) < 27.9  # 9 numbers, 99.9 %


@pytest.mark.parametrize(("claim_m", "noise_m"), [(0.3, 0.3), (3.0, 0.3), (0.1, 0.3)])
@pytest.mark.parametrize("seed", range(3))
def test_none_is_believed_where_there_is_none_whatever_positions_claim(claim_m, noise_m, seed):
    found = aligned(END_S + 1.0, 0.0, claim_m=claim_m, noise_m=noise_m, seed=seed)
    assert not found.jump.is_believed
    constant = aligned(END_S + 1.0, 0.0, claim_m=claim_m, noise_m=noise_m, jump_sigmas=None, seed=seed)
    assert constant.jump is None
    assert found.state.nav.equals(constant.state.nav, 1e-9), "a jump that is not believed changes nothing"


def test_a_drift_as_between_standstills_is_none_however_well_it_is_seen():
    assert not aligned(10.0, 0.15, claim_m=0.01, noise_m=0.001).jump.is_believed


def test_one_that_is_found_later_has_the_more_evidence():
    """So is told apart what looks like a jump by chance."""
    assert aligned(20.0, 2.0).jump.evidence > aligned(25.0, 2.0).jump.evidence + 10.0


@pytest.mark.parametrize(("by_deg_s", "by_m_s2"), [(6.0, 0.0), (0.0, 1.0), (4.0, 0.7)])
def test_a_bias_ten_times_larger_than_its_sigma_at_power_on_is_found_and_the_state_is_honest(by_deg_s, by_m_s2):
    """A start believed the datasheet, and was 42 m off ten seconds later."""
    at_power_on = np.repeat([0.1, 0.01], 3)
    found = aligned(-1.0, by_deg_s, by_m_s2=by_m_s2, known=at_power_on, jump_sigmas=None, motion=HILLS)
    truth = HILLS.nav((found.state.stamp_ns - ns(0.0)) * 1e-9)
    off = np.concatenate([by_m_s2 * AXIS, np.radians(by_deg_s) * AXIS])
    error = np.concatenate([truth.localCoordinates(found.state.nav), found.state.bias.vector() - off])
    assert error @ np.linalg.solve(found.state.covariance, error) < 37.7  # 15 numbers, 99.9 %


def test_what_is_known_of_a_bias_is_believed_where_it_is_right():
    rough, known = (aligned(-1.0, 0.0, known=scale * KNOWN, jump_sigmas=None, motion=HILLS) for scale in (10.0, 1.0))
    sigmas = [np.sqrt(np.diag(one.state.covariance)[9:]) for one in (rough, known)]
    assert (sigmas[1] < sigmas[0]).all() and (sigmas[1] <= 1.01 * KNOWN).all()
