"""The compiled path gives what GTSAM gives: preintegration, prediction and covariance, to the last digits."""

import gtsam
import numpy as np
import pytest
from alone import alone
from hypothesis import example, given
from hypothesis import strategies as st
from motion import G, machine
from reference import Propagation, transition

from holdfast.estimator.imu_path import ImuPath
from holdfast.event_log import EventLog
from holdfast.kernel import layout, preintegration, propagation
from holdfast.messages import ImuSample
from holdfast.sensors import preintegration as with_gtsam
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import MotionModel, preintegration_params
from holdfast.state import OptimisedState

integrate, predict = alone(preintegration.integrate), alone(preintegration.predict)
predict_covariance, reset = alone(preintegration.predict_covariance), alone(preintegration.reset)
move = alone(propagation.move)

CLOSE = 1e-10  # relative
RATES_HZ = st.sampled_from([10.0, 100.0, 400.0, 1000.0, 2000.0])
TURNING_RAD_S = st.sampled_from([0.0, 1e-9, 1e-5, 1e-2, 1.0, 10.0])
SEEDS = st.integers(0, 2**32 - 1)
DENSITIES = np.array([2e-3, 2e-4, 1e-4])


def close(found, expected, scale=None):
    """Whether two arrays agree, relative to the largest number in them or to a scale."""
    largest = max(np.abs(expected).max(), 1e-30) if scale is None else scale
    return np.abs(np.asarray(found) - expected).max() <= CLOSE * largest


def states(rng):
    """A state anywhere, also upside down, its bias, and a covariance of both."""
    nav = gtsam.NavState(gtsam.Rot3.Expmap(rng.normal(0.0, 2.0, 3)), rng.normal(0.0, 300.0, 3), rng.normal(0.0, 5.0, 3))
    bias = gtsam.imuBias.ConstantBias(rng.normal(0.0, 0.1, 3), rng.normal(0.0, 0.01, 3))
    A = rng.normal(size=(15, 15)) * np.repeat([1e-3, 1e-2, 1e-2, 1e-2, 1e-4], 3)[:, None]
    return nav, bias, A @ A.T


class Kernel:
    """The compiled functions on a record of their own."""

    def __init__(self, nav, covariance):
        self.one, self.work = np.zeros(1, layout.PROPAGATION)[0], np.zeros(1, layout.WORK)[0]
        self.one["noise"], self.one["P"] = DENSITIES**2, covariance
        self.one["start"] = nav.attitude().matrix(), nav.position(), nav.velocity()
        self.pim = self.one["pim"]
        reset(self.pim)

    def predict(self):
        predict(self.pim, self.work, self.one["start"], G, self.one["nav"])
        predict_covariance(self.pim, self.work, self.one["P"], self.work["covariance"])
        return self.one["nav"], self.work["covariance"], self.work["cross"]


def agree(kernel, pim, nav, bias, covariance):
    """Compare all that a preintegrated measurement and its prediction consist of."""
    assert kernel.pim["dt_s"] == pytest.approx(pim.deltaTij(), rel=CLOSE)
    tangent = np.concatenate([kernel.pim["theta"], kernel.pim["p"], kernel.pim["v"]])
    assert close(tangent, pim.preintegrated())
    assert close(kernel.pim["covariance"], pim.preintMeasCov())
    F = transition(pim, nav, bias)
    expected, (found, found_covariance, cross) = pim.predict(nav, bias), kernel.predict()
    assert close(found["R"], expected.attitude().matrix())
    assert close(found["p"], expected.position())
    assert close(found["v"], expected.velocity(), max(1.0, np.abs(expected.velocity()).max()))
    assert close(found_covariance, F @ covariance @ F.T + pim.residualCovariance())
    assert close(cross, F @ covariance[:, 9:])


@given(seed=SEEDS, hz=RATES_HZ, turning_rad_s=TURNING_RAD_S, count=st.integers(1, 300))
@example(seed=1, hz=2000.0, turning_rad_s=10.0, count=600)
def test_preintegration_and_prediction_are_those_of_gtsam(seed, hz, turning_rad_s, count):
    rng = np.random.default_rng(seed)
    nav, bias, covariance = states(rng)
    kernel, pim = (
        Kernel(nav, covariance),
        gtsam.PreintegratedImuMeasurements(preintegration_params(*DENSITIES, G), bias),
    )
    main = rng.normal(0.0, 1.0, 3) * turning_rad_s
    for _ in range(min(count, round(3.0 / max(turning_rad_s, 0.1) * hz) + 1)):  # the tangent space ends at a turn
        dt_s = rng.uniform(0.5, 1.5) / hz
        force, rate = rng.normal([0.0, 0.0, G], 5.0), main + rng.normal(0.0, 0.1, 3) * turning_rad_s
        accel, gyro = bias.accelerometer(), bias.gyroscope()
        with_gtsam.integrate(pim, with_gtsam.Step(dt_s, force + accel, rate + gyro), accel, gyro)
        integrate(kernel.pim, kernel.work, kernel.one["noise"], dt_s, *force, *rate)
    agree(kernel, pim, nav, bias, covariance)


@given(seed=SEEDS, angle_rad=st.sampled_from([1e-12, 9.99e-3, 1.001e-2, 1.0, np.pi - 1e-9, np.pi, np.pi + 1e-6, 4.0]))
def test_a_rotation_near_none_and_near_half_a_turn_is_no_exception(seed, angle_rad):
    rng = np.random.default_rng(seed)
    nav, bias, covariance = states(rng)
    axis = rng.normal(size=3)
    rate = axis / np.linalg.norm(axis) * angle_rad / 0.5
    kernel, pim = (
        Kernel(nav, covariance),
        gtsam.PreintegratedImuMeasurements(preintegration_params(*DENSITIES, G), bias),
    )
    accel, gyro = bias.accelerometer(), bias.gyroscope()
    for _ in range(50):
        force = rng.normal(0.0, 5.0, 3)
        with_gtsam.integrate(pim, with_gtsam.Step(0.01, force + accel, rate + gyro), accel, gyro)
        integrate(kernel.pim, kernel.work, kernel.one["noise"], 0.01, *force, *rate)
    agree(kernel, pim, nav, bias, covariance)


@given(seed=SEEDS, duration_s=st.sampled_from([1e-3, 0.013, 0.5, 1.99, 10.0, 3600.0]))
def test_the_motion_model_is_that_of_the_graph(seed, duration_s):
    rng = np.random.default_rng(seed)
    nav, bias, covariance = states(rng)
    config, rate = machine().motion_model, rng.normal(0.0, 0.5, 3) / max(1.0, duration_s)
    kernel = Kernel(nav, covariance)
    kernel.one["noise"] = np.square([config.acceleration_density, config.angular_rate_density, 0.1])
    move(kernel.pim, kernel.work, kernel.one["noise"], kernel.one["start"], rate, G, duration_s)
    agree(kernel, MotionModel(config, G).preintegrate(duration_s, nav, rate, bias), nav, bias, covariance)


def readings(rng, hz, count):
    """Stamps and readings of a machine that moves at random, smoothly; sometimes silent, sometimes on a line."""
    stamp_ns, found = 10**18, []
    force, rate = np.array([0.0, 0.0, G]), np.zeros(3)
    for k in range(count):
        stamp_ns += round(1e9 / hz * rng.uniform(0.8, 1.2))
        if rng.random() < 3.0 / count:
            stamp_ns += round(rng.uniform(0.0, 2.0) * 1e9)
        if 0.4 < k / count < 0.6:
            force, rate = force + 1e-3, rate + 1e-4
        else:
            force = force + rng.normal(0.0, 0.2, 3) - 0.02 * (force - [0.0, 0.0, G])
            rate = rate + rng.normal(0.0, 0.02, 3) - 0.02 * rate
        found.append((stamp_ns, force, rate))
    return found


@given(seed=SEEDS, hz=st.sampled_from([50.0, 100.0, 400.0, 2000.0]))
def test_every_estimate_is_what_gtsam_makes_of_the_samples_through_gaps_lines_and_folds(seed, hz):
    rng = np.random.default_rng(seed)
    nav, bias, covariance = states(rng)
    config, given_ = machine(), readings(rng, hz, 400)
    buffer, other = ImuBuffer(config.imu), ImuBuffer(config.imu)
    path, state, reference = ImuPath(config, buffer, EventLog("imu")), None, None
    for stamp_ns, force, rate in given_:
        sample = ImuSample(stamp_ns, stamp_ns, "imu", rate, force)
        received = path.process(sample)
        assert received is not None and other.add(sample) == (received.has_step, received.line_since_ns)
        if state is None:
            state = OptimisedState(stamp_ns, nav, bias, covariance, rate - bias.gyroscope())
            path.start(state, G)
            reference = Propagation(config, other, G, state)
            continue
        if received.line_since_ns is not None:
            reference = Propagation(config, other, G, state)  # what looked good was a line
            reference.replay()
        else:
            reference.advance(stamp_ns, received.has_step)
        expected, expected_covariance = reference.predict()
        estimate = received.estimate
        assert close(estimate.rotation, expected.attitude().matrix())
        assert close(estimate.position, expected.position())
        assert close(estimate.velocity, expected.velocity(), max(1.0, np.abs(expected.velocity()).max()))
        assert close(estimate.covariance, expected_covariance)
        assert close(estimate.angular_velocity, reference.rate, 1.0)
        assert estimate.from_imu == (received.has_step and reference.from_imu)


@pytest.mark.parametrize("hz", [100.0, 1000.0])
def test_propagating_again_from_the_same_state_arrives_where_each_sample_alone_did(hz):
    """One call over the samples since, and a call for each: equal but for the base that is laid each second."""
    rng = np.random.default_rng(5)
    nav, bias, covariance = states(rng)
    config = machine()
    path, state, estimate = ImuPath(config, ImuBuffer(config.imu), EventLog("imu")), None, None
    stamp_ns = 10**18
    for k in range(round(0.9 * hz)):
        stamp_ns += round(1e9 / hz)
        force, rate = np.array([np.sin(0.1 * k), 0.3, G + np.cos(0.3 * k)]), np.array([0.3, np.sin(0.05 * k), 0.1])
        received = path.process(ImuSample(stamp_ns, stamp_ns, "imu", rate, force))
        estimate = received.estimate
        if state is None:
            state = OptimisedState(stamp_ns, nav, bias, covariance, rate - bias.gyroscope())
            path.start(state, G)
    path.anchor(state, is_recovery=False)
    stamp_ns += round(1e9 / hz)
    path.process(ImuSample(stamp_ns, stamp_ns, "imu", rate, force))
    predictor = path._predictor
    one, other = predictor._propagations
    assert close(one["nav"]["p"], other["nav"]["p"]) and close(one["nav"]["R"], other["nav"]["R"])
    assert estimate is not None and close(one["nav"]["v"], other["nav"]["v"])
