"""A gyroscope whose bias jumps within the window of a batch: when, by how much, and whether that is believed."""

from dataclasses import replace

import numpy as np
import pytest
from motion import ARM, Drive, G, imu, machine, ns
from rig import NO_BIAS, buffered, position

from holdfast.graph.alignment import BatchAligner
from holdfast.graph.alignment_problem import BiasPrior, Evidence
from holdfast.sensors.preintegration import ImuNoise
from holdfast.sensors.registry import sensors_of

CONFIG = machine()
KNOWN, DOUBTED = np.repeat([0.1, 2e-3], 3), np.repeat([0.1, 0.03], 3)
ROAD = Drive(start_s=-4.0, radius_m=20.0, speed=0.3, tilt=0.0, heave_m=0.0)  # 6 m/s
END_S, AXIS = 30.0, np.array([0.6, 0.0, 0.8])


def aligned(at_s, by_deg_s, *, claim_m=0.3, noise_m=0.3, jump_sigmas=DOUBTED, seed=0):
    """The batch of 30 s in which the bias jumps; positions every second."""
    rng, by = np.random.default_rng(seed), np.radians(by_deg_s) * AXIS
    samples = [
        replace(one, angular_velocity=one.angular_velocity + by) if one.stamp_ns > ns(at_s) else one
        for one in imu(ROAD, 0.0, END_S + 0.1, 100.0, rng)
    ]
    noise = ImuNoise(CONFIG.imu, CONFIG.graph.position_integration_sigma, G)
    buffer = buffered(ROAD, END_S, samples=samples)
    aligner = BatchAligner(buffer, noise, {"gnss": sensors_of(CONFIG)["gnss"]}, {})
    times = np.arange(0.5, END_S, 1.0)
    fixes = [position(ROAD, t, ARM, rng.normal(0.0, noise_m, 3), sigma_m=claim_m) for t in times]
    return aligner.solve(Evidence(fixes, []), BiasPrior(NO_BIAS, KNOWN), np.radians(30.0), jump_sigmas)


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
    assert aligned(14.0, 2.0).jump.evidence > aligned(20.0, 2.0).jump.evidence + 10.0
