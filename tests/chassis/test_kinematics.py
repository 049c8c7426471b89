"""The chassis below a slewing cabin: known answers, the simulator's truth, and readings in any order."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from alone import alone
from slewing import (
    AT_REST,
    DRIVING,
    MAX_ATTITUDE_DEG,
    MAX_POSITION_M,
    MAX_YAW_RATE_RAD_S,
    T_B_P,
    T_W_O,
    TIMES,
    Chassis,
    calibrated,
    chassis_at,
    encoder_zero_rad,
    estimates,
    machine,
    messages_of,
    mount,
    ns,
    received,
    rms,
    run_simulated,
    simulated,
)

from holdfast.chassis.covariances import BaseUncertainty
from holdfast.chassis.kinematics import BaseGeometry
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.kernel import turn_joint
from holdfast.messages import FixStatus, GnssFix, ImuSample, JointAngle
from holdfast.ros.rows import Rows
from holdfast.sim.scenario import load_scenario
from holdfast.sim.simulation import simulate
from holdfast.state import PUBLISHED, BaseState, EncoderState, Estimate

place = alone(turn_joint.place)

AXIS = T_B_P.rotation().matrix()[:, 2]  # of the joint, in B
SLEWING_RAD_S = 0.3


# --- geometry ---------------------------------------------------------------------------------------------------------


def placed(mount, given, *motion):
    """The chassis at an estimate: angle of the joint and its sigma, rate of the chassis and its sigma."""
    values = given.values.copy()
    row = values.view(PUBLISHED)[0]
    place(mount[0], row["estimate"], np.array(motion), row["chassis"])
    return BaseState(given.stamp_ns, values, EncoderState.OK)


@pytest.mark.parametrize("t", [0.0, 1.3, 4.0, 7.7])
def test_pose_and_twist_of_the_chassis_are_its_own_however_the_cabin_turns(t):
    geometry, given = BaseGeometry(machine()), DRIVING.estimate(t)
    angle, about = DRIVING.angle(t), DRIVING.omega @ AXIS
    state = placed(geometry.record(has_joint=True), given, angle, 0.0, about, 0.0)
    found = given.nav.pose() * geometry.T_I_B(angle)
    np.testing.assert_allclose(found.matrix(), DRIVING.T_W_B(t).matrix(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.T_W_B.matrix(), found.matrix(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.T_O_B.matrix(), given.T_W_O.between(found).matrix(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.velocity, DRIVING.velocity, rtol=0, atol=1e-8)  # differences know no more
    np.testing.assert_allclose(state.angular_velocity, DRIVING.omega, rtol=0, atol=1e-8)


def test_without_a_turn_joint_the_chassis_is_rigid_with_the_imu():
    T_I_B = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 2.5), np.array([-1.1, 0.6, -1.7]))
    config = Config.model_validate(
        {"sensors": {"imu": {"kind": "imu", "topic": "/imu"}}, "extrinsics": [mount("imu", "base_link", T_I_B)]}
    )
    run, h = Chassis(config), 1e-5
    for t in (0.0, 2.1):
        (state,) = run.run([DRIVING.estimate(t)], [DRIVING.reading(t)])
        before, here, after = (DRIVING.T_W_I(x) * T_I_B for x in (t - h, t, t + h))
        v_W = (after.translation() - before.translation()) / (2 * h)
        rate = gtsam.Rot3.Logmap(before.rotation().between(after.rotation())) / (2 * h)
        np.testing.assert_allclose(state.T_W_B.matrix(), here.matrix(), rtol=0, atol=1e-12)
        np.testing.assert_allclose(state.T_O_B.matrix(), (T_W_O.inverse() * here).matrix(), rtol=0, atol=1e-12)
        np.testing.assert_allclose(state.velocity, here.rotation().unrotate(v_W), rtol=0, atol=1e-8)
        np.testing.assert_allclose(state.angular_velocity, rate, rtol=0, atol=1e-8)
        assert (state.encoder, state.joint_rate_rad_s) == (None, 0.0)
    assert run.counts["joint", "ignored"] == 2
    assert run.log.events == []


def test_covariances_are_those_of_samples():
    rng = np.random.default_rng(4)
    A = rng.normal(size=(9, 9)) * np.repeat([1e-3, 2e-3, 2e-3], 3)[:, None]
    P = A @ A.T / 9.0
    geometry, t, sigmas = BaseGeometry(machine()), 2.0, (5e-3, 5e-3, 3e-3)
    mount = geometry.record(has_joint=True)
    given, angle, about = DRIVING.estimate(t), DRIVING.angle(t), DRIVING.omega @ AXIS
    given.covariance[:] = P

    def state(given, angle, about):
        return placed(mount, given, angle, sigmas[0], about, sigmas[1])

    mean, errors = state(given, angle, about), []
    for _ in range(4000):
        rate = given.angular_velocity + rng.normal(0.0, sigmas[2], 3)
        nav = given.nav.retract(rng.multivariate_normal(np.zeros(9), P))
        shifted = Estimate.of(given.stamp_ns, nav, given.T_W_O, given.bias, P, rate, True)
        other = state(shifted, angle + rng.normal(0.0, sigmas[0]), about + rng.normal(0.0, sigmas[1]))
        pose = gtsam.Pose3.Logmap(mean.T_W_B.between(other.T_W_B))
        errors.append([*pose, *(other.angular_velocity - mean.angular_velocity), *(other.velocity - mean.velocity)])
    found = np.cov(np.array(errors).T)
    uncertainty = BaseUncertainty(machine())
    rows = Rows.of([given, DRIVING.estimate(3.0)], [mean, mean])
    variances = np.array([sigmas[2] ** 2, 1.0])
    of_two = uncertainty.covariances(rows.covariances, rows.velocities, rows.chassis, variances)
    for block, expected in zip((slice(6), slice(6, 12)), (of_two.pose[0], of_two.twist[0]), strict=True):
        part = found[block, block]
        # five standard deviations of what so many samples can tell
        std = np.sqrt((np.outer(np.diag(part), np.diag(part)) + part**2) / len(errors))
        assert (abs(part - expected) < 5 * std).all()


# --- readings ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint_s", [0.0, 0.004, 0.05, 0.15])
def test_a_reading_that_lags_is_carried_to_the_stamp_of_the_estimate(joint_s):
    states = Chassis(machine()).run(estimates(DRIVING), received(DRIVING, joint_s=joint_s))
    late = [(t, state) for t, state in zip(TIMES, states, strict=True) if t > 6.0]
    angles = np.array([state.joint_angle_rad - DRIVING.angle(t) for t, state in late])
    # without carrying: 0.75 rad/s * 0.15 s = 0.11 rad
    assert abs(angles).max() < 1e-3
    for t, state in late[::50]:
        error = DRIVING.T_W_B(t).between(state.T_W_B)
        assert np.linalg.norm(error.translation()) < 2e-3
        np.testing.assert_allclose(state.angular_velocity, DRIVING.omega, rtol=0, atol=MAX_YAW_RATE_RAD_S)
        assert state.joint_rate_rad_s == pytest.approx(DRIVING.angle_rate(t), abs=MAX_YAW_RATE_RAD_S)


def test_the_order_of_arrival_between_two_estimates_changes_nothing():
    messages = received(DRIVING, TIMES[:300])
    shuffled = []
    for message in messages:  # all arrive with the next estimate, in another order
        arrival = ((message.arrival_ns - ns(0.0)) // 10_000_000 + 1) * 10_000_000 + ns(0.0)
        shuffled.append(replace(message, arrival_ns=arrival))
    given = estimates(DRIVING, TIMES[:310])
    once, twice = (Chassis(machine()).run(given, order)[-1] for order in (shuffled, shuffled[::-1]))
    assert once.joint_angle_rad == twice.joint_angle_rad
    np.testing.assert_array_equal(once.T_W_B.matrix(), twice.T_W_B.matrix())
    np.testing.assert_array_equal(once.angular_velocity, twice.angular_velocity)


def test_an_encoder_that_wraps_reads_the_same_angle():
    far = replace(DRIVING, swing_rad=5.0)
    messages = received(far)
    wrapped = [
        replace(m, angle_rad=float(np.arctan2(np.sin(m.angle_rad), np.cos(m.angle_rad))))
        if isinstance(m, JointAngle)
        else m
        for m in messages
    ]
    assert any(m.angle_rad != w.angle_rad for m, w in zip(messages, wrapped, strict=True) if isinstance(m, JointAngle))
    runs = Chassis(machine()), Chassis(machine())
    orders = zip(runs, (messages, wrapped), strict=True)
    plain, turned = (run.run(estimates(far), order)[-1] for run, order in orders)
    assert turned.joint_angle_rad == pytest.approx(plain.joint_angle_rad, abs=1e-6)
    assert runs[0].counts == runs[1].counts
    assert ("joint", "innovation") not in runs[1].counts


def test_the_encoder_leads_across_a_gap_of_the_cabins_imu():
    messages = received(DRIVING)
    given = []
    for t in TIMES:
        gap_s = t - 6.0
        if 0.0 < gap_s < 0.995:
            continue  # then one estimate with the rate of before: the cabin turned by 0.4 rad less than that
        is_first = 0.0 < gap_s < 1.005
        estimate = DRIVING.estimate(t)
        stale = DRIVING.estimate(3.0).angular_velocity * -1.0
        if is_first:
            estimate = estimate._replace(from_imu=False)
            estimate.angular_velocity[:] = stale
        given.append(estimate)
    run = Chassis(machine())
    states = run.run(given, messages)
    after = [state for state in states[5:] if state.stamp_ns > ns(6.5)]
    angles = np.array([state.joint_angle_rad - DRIVING.angle((state.stamp_ns - ns(0.0)) * 1e-9) for state in after])
    assert abs(angles).max() < 3e-3
    assert ("joint", "innovation") not in run.counts


def test_the_bias_of_the_base_gyroscope_is_learnt_from_the_encoder():
    bias = 0.02  # two sigmas of the default; 1.1 deg/s
    run = Chassis(machine())
    states = run.run(estimates(DRIVING), received(DRIVING, bias=bias))
    about = np.array([state.angular_velocity @ AXIS for state in states[600:]])
    assert abs(about - DRIVING.omega @ AXIS).max() < MAX_YAW_RATE_RAD_S


def test_every_reading_is_counted_under_what_became_of_it():
    config = machine()
    good = [*received(DRIVING, TIMES[10:50])]
    rate, t = DRIVING.base_sample(0.2), 0.45
    bad = [
        JointAngle(ns(t), ns(t), "joint", float("nan")),
        JointAngle(ns(0.403), ns(t), "joint", 0.5),  # a duplicate
        JointAngle(ns(0.05), ns(t), "joint", 0.5),  # older than max_age_s
        JointAngle(ns(t + 30.0), ns(t), "joint", 0.5),
        JointAngle(ns(0.0), ns(-0.1), "joint", 0.5),  # before the first estimate
        replace(rate, stamp_ns=ns(t), arrival_ns=ns(t), angular_velocity=np.array([0.0, np.nan, 0.0])),
        ImuSample(ns(t), ns(t), "base_imu", np.array([0.0, 0.0, 36.0]), AT_REST),
        ImuSample(ns(t), ns(t), "base_imu", np.zeros(3), np.array([0.0, 0.0, -161.0])),
    ]
    run = Chassis(config)
    run.run(estimates(DRIVING, TIMES[:60]), [*good, *bad])
    assert run.counts == {
        ("joint", "used"): 40,
        ("joint", "not_finite"): 1,
        ("joint", "duplicate"): 1,
        ("joint", "late"): 1,
        ("joint", "clock_jump"): 1,
        ("joint", "before_start"): 1,
        ("base_imu", "used"): 40,
        ("base_imu", "not_finite"): 1,
        ("base_imu", "out_of_range"): 2,
    }


@pytest.mark.parametrize("seed", range(20))
def test_whatever_the_sensors_send_every_state_is_finite(seed):
    rng = np.random.default_rng(seed)
    messages = []
    for message in received(DRIVING, TIMES[:400]):
        kind = rng.integers(12)
        shift_ns = round(rng.normal(0.0, rng.choice([1e-3, 0.05, 1.0, 1e4])) * 1e9) if kind < 3 else 0
        changed = replace(message, stamp_ns=message.stamp_ns + shift_ns)
        if kind == 3 and isinstance(message, JointAngle):
            changed = replace(changed, angle_rad=float(rng.choice([np.nan, np.inf, 1e9, -7.0, 0.0])))
        if kind == 4 and isinstance(message, ImuSample):
            changed = replace(changed, angular_velocity=rng.choice([np.nan, 30.0, -30.0, 0.0], 3))
        messages += [changed] * rng.integers(0, 3)
    given = [e._replace(from_imu=bool(rng.integers(9))) for e in estimates(DRIVING, TIMES[:400]) if rng.integers(5)]
    run = Chassis(machine(base_imu=bool(seed % 4)))
    states = [state for state in run.run(given, messages) if state is not None]
    assert len(states) > 100
    for state in states:
        numbers = [*state.velocity, *state.angular_velocity, state.joint_angle_rad, state.joint_angle_sigma_rad]
        assert np.isfinite(numbers).all()
        assert np.isfinite(state.T_O_B.matrix()).all()
        assert state.turn_rate_sigma_rad_s >= 0.0
    waiting = sum(count for (sensor, _), count in run.counts.items() if sensor != "imu")
    assert len(messages) - 60 <= waiting <= len(messages)  # each is counted once, or waits for its stamp


def test_a_clock_that_goes_back_begins_anew():
    run = Chassis(machine())
    run.run(estimates(DRIVING), received(DRIVING))
    earlier = TIMES[:200] - 100.0
    states = run.run(estimates(DRIVING, earlier), received(DRIVING, earlier))
    assert states[0] is None
    assert abs(states[-1].joint_angle_rad - DRIVING.angle(earlier[-1])) < 1e-3


def test_readings_that_were_taken_in_before_the_clock_went_back_are_counted():
    base, log = (run := Chassis(machine())).base, run.log
    chassis_at(base, DRIVING.estimate(1.0))
    for t in (0.97, 0.98, 0.99):  # the estimate has reached them: they are taken in at once, and not counted yet
        base.add(DRIVING.reading(t), ns(1.0))
    assert ("joint", "used") not in log.counts
    chassis_at(base, DRIVING.estimate(-99.0))
    base.count()
    assert sum(log.counts.values()) == 3


# --- the simulator's truth --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_chassis_stays_true_while_the_cabin_slews(seed):
    run, found = run_simulated(simulated(seed))
    slews = found.during((found.slew_rad_s > SLEWING_RAD_S) & (found.times_s > 2.0))
    assert len(slews.times_s) > 1500
    assert np.degrees(rms(slews.attitude_rad)) <= MAX_ATTITUDE_DEG
    assert rms(slews.position_m) <= MAX_POSITION_M
    settled = found.between(2.0, 40.0)
    for part in (slews, settled):
        assert rms(part.rate_rad_s[:, 2]) <= MAX_YAW_RATE_RAD_S
        # the cabin shakes on its mounts by 2.3e-3 rad/s and, on an arm of a metre, as many m/s
        assert rms(part.rate_rad_s[:, :2]) <= MAX_YAW_RATE_RAD_S
        assert rms(part.velocity_m_s) <= 0.01
    assert [text for _, text in run.encoder_states()] == ["ok"]
    # before the base gyroscope has measured, no reading can be carried on
    assert run.counts.pop(("joint", "late"), 0) <= 2
    assert set(run.counts) == {("joint", "used"), ("base_imu", "used")}


def test_the_zero_offset_of_the_configuration_turns_the_chassis():
    simulation = simulated(2)
    _, right = run_simulated(simulation)
    _, off = run_simulated(simulation, calibrated(simulation, zero_offset_deg=0.0))
    assert rms(right.between(2.0, 40.0).angle_rad) < 0.5e-3
    turned = off.between(2.0, 40.0).angle_rad.mean()
    assert turned == pytest.approx(encoder_zero_rad(simulation), abs=2e-4)  # the encoder's white noise
    # with the 2 mrad of the datasheet, which the truth obeys, it is learnt while driving
    datasheet = calibrated(simulation, zero_offset_deg=0.0, zero_offset_sigma_deg=np.degrees(2e-3))
    _, learnt = run_simulated(simulation, datasheet)
    first, last = learnt.states[0].joint_angle_sigma_rad, learnt.states[-1].joint_angle_sigma_rad
    assert first >= 2e-3 > last
    assert abs(learnt.angle_rad[-1]) < 3.0 * last


def test_the_sigmas_cover_the_errors():
    for seed in (1, 2):
        _, errors = run_simulated(simulated(seed))
        rate = np.array([state.turn_rate_sigma_rad_s for state in errors.states])
        settled = errors.times_s > 2.0
        ratio = rms(errors.rate_rad_s[settled, 2] / rate[settled])
        assert 0.2 < ratio < 1.2  # the chassis turns less than the filter allows for
        angle = np.array([s.joint_angle_sigma_rad for s in errors.states])
        assert 0.4 < rms(errors.angle_rad[settled] / angle[settled]) < 1.6


def test_without_a_base_imu_the_encoder_measures_how_the_chassis_turns():
    _, found = run_simulated(simulated(1), names=("joint",))
    slews = found.during((found.slew_rad_s > SLEWING_RAD_S) & (found.times_s > 2.0))
    assert np.degrees(rms(slews.attitude_rad)) <= MAX_ATTITUDE_DEG
    # noise and steps of the encoder: 3e-4 rad, distinguished from turning within about 15 ms
    assert rms(found.between(2.0, 40.0).rate_rad_s[:, 2]) <= 0.02
    assert rms(slews.rate_rad_s[:, 2]) <= 0.02


# --- the whole estimator ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def quick():
    """The shipped scenario through the estimator: outputs with an estimate, by stamp."""
    simulation = simulate(load_scenario("quick"), 1)
    messages = messages_of(simulation, "imu", "base_imu", "joint")
    for name in ("gnss", "gnss_right"):
        delivered = simulation.delivered[name]
        values = delivered.readings.values
        for row, (stamp, arrival) in enumerate(
            zip(delivered.stamps_ns.tolist(), delivered.arrivals_ns.tolist(), strict=True)
        ):
            point = simulation.world.to_geodetic(values["position"][row])
            covariance = np.diag(values["sigma"][row] ** 2)
            messages.append(GnssFix(stamp, arrival, name, *point, covariance, FixStatus.GBAS))
    estimator = Estimator(calibrated(simulation))
    outputs = [estimator.process(m) for m in sorted(messages, key=lambda m: (m.arrival_ns, m.sensor))]
    return simulation, estimator, [output for output in outputs if output.estimate is not None]


def test_the_estimator_gives_the_chassis_with_every_estimate_once_the_encoder_has_been_read(quick):
    _, estimator, outputs = quick
    without = [output for output in outputs if output.base is None]
    assert len(without) <= 5
    assert outputs[: len(without)] == without
    assert all(output.base.stamp_ns == output.estimate.stamp_ns for output in outputs[len(without) :])
    assert estimator.counts["base_imu", "used"] > 1500
    assert estimator.counts["joint", "used"] > 1500
    assert estimator.event_counts["encoder"] == 1


def test_the_estimator_keeps_the_chassis_true_to_its_own_cabin(quick):
    simulation, _, outputs = quick
    times_s = simulation.delivered["imu"].readings.times_s
    rows = dict(zip(simulation.delivered["imu"].stamps_ns.tolist(), range(len(times_s)), strict=True))
    cabin, chassis = (simulation.motion.frame(frame, times_s) for frame in ("imu", "base_link"))
    _, slew = simulation.motion.joint(times_s)
    rotations, shifts, rates = [], [], []
    for output in outputs:
        row = rows[output.estimate.stamp_ns]
        if output.base is None or times_s[row] < 2.0:
            continue
        T_W_I, T_W_B = (gtsam.Pose3(gtsam.Rot3(m.R_W_F[row]), m.p_W[row]) for m in (cabin, chassis))
        T_O_I = output.estimate.T_W_O.inverse() * output.estimate.nav.pose()
        error = T_W_I.between(T_W_B).between(T_O_I.between(output.base.T_O_B))
        rates.append(output.base.angular_velocity[2] - chassis.angular_velocity[row, 2])
        if abs(slew[row]) > SLEWING_RAD_S:
            rotations.append(gtsam.Rot3.Logmap(error.rotation()))
            shifts.append(error.translation())
    assert len(rotations) > 300
    assert np.degrees(rms(np.array(rotations))) <= MAX_ATTITUDE_DEG
    assert rms(np.array(shifts)) <= MAX_POSITION_M
    assert rms(np.array(rates)) <= MAX_YAW_RATE_RAD_S


def test_the_base_imu_is_no_second_imu_of_the_cabin(quick):
    _, estimator, outputs = quick
    assert estimator.counts["imu", "used"] == 2000
    stamps = [output.estimate.stamp_ns for output in outputs]
    assert (np.diff(stamps) == 10_000_000).all()
