"""The covariance at IMU rate explains the error of the estimate: Monte Carlo over seeds, noise as configured."""

import numpy as np
import pytest
from motion import Drive, error, estimates, fixes, imu, in_order, machine, ns, run, scans

from holdfast.estimator.estimator import Estimator
from holdfast.evaluation.consistency import consistency

IMU = {"accelerometer_noise_density": 2e-3, "gyroscope_noise_density": 2e-4, "accelerometer_bias_sigma": 0.05}
WALK = (1e-4, 1e-5)
RUNS = 60
PARTS = {"rotation": slice(0, 3), "position": slice(3, 6), "velocity": slice(6, 9)}


def simulated(seed, end_s, gnss_until_s, hz=50.0, lidar=False):
    """One run with its own noise, biases and heading error; estimates by stamp."""
    rng = np.random.default_rng(1000 + seed)
    drive = Drive()
    bias = np.concatenate([rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.005, 3)])
    streams = [
        imu(drive, 0.0, end_s, hz, rng, (2e-3, 2e-4), bias, walk=WALK),
        fixes(drive, 0.0, gnss_until_s, 5.0, rng, phase_s=0.0137),
    ]
    if lidar:
        streams.append(scans(drive, 0.0, end_s, 5.0, rng, phase_s=0.0071))
    heading = np.degrees(0.3) + rng.normal(0.0, 2.0)
    config = machine(lidar=lidar, imu_=IMU, heading_deg=heading)
    return drive, {e.stamp_ns: e for e in estimates(run(config, in_order(*streams))[1])}


def verdicts(runs, stamp_ns):
    errors = np.array([error(drive, given[stamp_ns]) for drive, given in runs])
    covariances = np.array([given[stamp_ns].covariance for _, given in runs])
    return {name: consistency(errors[:, part], covariances[:, part, part], 0.999) for name, part in PARTS.items()} | {
        "all": consistency(errors, covariances, 0.999)
    }


@pytest.fixture(scope="module")
def runs():
    """GNSS until 9 s, then the IMU alone."""
    return [simulated(seed, 19.0, 9.0) for seed in range(RUNS)]


@pytest.mark.parametrize("t", [7.02, 8.0, 9.0])
def test_errors_while_driving_are_explained_by_the_covariance(runs, t):
    for verdict in verdicts(runs, ns(t)).values():
        assert verdict.lower_per_dof < verdict.mean_nees_per_dof < verdict.upper_per_dof


@pytest.mark.parametrize("part", ["rotation", "position", "velocity"])
def test_errors_at_standstill_are_explained_by_the_covariance(runs, part):
    """Roll and pitch from gravity are wrong by exactly the bias of the accelerometer across it."""
    verdict = verdicts(runs, ns(2.4))[part]
    assert verdict.mean_nees_per_dof < verdict.upper_per_dof


def test_dead_reckoning_with_the_imu_alone_is_as_wrong_as_the_covariance_claims(runs):
    traces = []
    for t in (9.0, 10.0, 12.0, 15.0, 19.0):
        verdict = verdicts(runs, ns(t))["position"]
        assert verdict.lower_per_dof < verdict.mean_nees_per_dof < verdict.upper_per_dof
        traces.append(np.mean([np.trace(given[ns(t)].covariance[3:6, 3:6]) for _, given in runs]))
        measured = np.mean([np.sum(error(drive, given[ns(t)])[3:6] ** 2) for drive, given in runs])
        # the mean of squares of (at worst) one dominant direction: sqrt(2 / runs), four of those
        assert measured == pytest.approx(traces[-1], rel=4.0 * np.sqrt(2.0 / RUNS))
    assert (np.diff(traces) > 0.0).all() and traces[-1] > 100.0 * traces[0]


def test_uncertainty_grows_while_only_the_imu_measures_and_never_loses_its_shape():
    _, given = simulated(0, 14.0, 6.0)
    outage = [e for stamp, e in sorted(given.items()) if stamp > ns(6.2)]
    traces = np.array([np.trace(e.covariance[3:6, 3:6]) for e in outage])
    assert (np.diff(traces) > -1e-3 * traces[:-1]).all() and traces[-1] > 10.0 * traces[0]
    for e in outage:
        np.testing.assert_allclose(e.covariance, e.covariance.T, atol=1e-9 * abs(e.covariance).max())
        assert np.linalg.eigvalsh(e.covariance).min() > 0.0


def test_a_covariance_that_is_asked_for_later_is_the_one_of_its_time():
    drive = Drive()
    messages = in_order(imu(drive, 0.0, 9.0, 50.0), fixes(drive, 0.0, 6.0, 5.0))
    estimator, at_once = Estimator(machine()), []
    for message in messages:
        estimate = estimator.process(message).estimate
        if estimate is not None:
            at_once.append(estimate.covariance)
    later = [estimate.covariance for estimate in estimates(run(machine(), messages)[1])]
    assert len(later) > 200
    for one, other in zip(at_once, later, strict=True):
        np.testing.assert_array_equal(one, other)
