"""O never jumps: T_W_O takes every correction, so that T_O_I moves as the IMU does."""

import itertools

import gtsam
import numpy as np
import pytest
from alone import alone
from hypothesis import given
from hypothesis import strategies as st
from motion import Drive, estimates, fixes, imu, in_order, machine, ns, run, scans

from holdfast.evaluation.soundness import violations
from holdfast.kernel import layout, odometry_frame
from holdfast.replay.published import PublishedRecorder

correct, flow = alone(odometry_frame.correct), alone(odometry_frame.flow)


class OdometryFrame:
    """The compiled frame, asked by poses."""

    def __init__(self, policy):
        self.one, self.work = np.zeros(1, layout.FRAME)[0], np.zeros(1, layout.WORK)[0]
        self.one["always"] = policy == "always"
        for name in ("T_W_O", "rest"):
            self.one[name]["R"] = np.eye(3)

    @property
    def T_W_O(self):
        return gtsam.Pose3(gtsam.Rot3(self.one["T_W_O"]["R"]), self.one["T_W_O"]["p"])

    def correct(self, before, after, *, is_recovery):
        navs = np.zeros(2, layout.NAV)
        for nav, T in zip(navs, (before, after), strict=True):
            nav["R"], nav["p"] = T.rotation().matrix(), T.translation()
        correct(self.one, self.work, navs[0], navs[1], is_recovery)

    def flow(self, T_W_I, dt_s):
        flow(self.one, self.work, np.array(T_W_I.translation()), dt_s)


def pose(rng):
    return gtsam.Pose3.Expmap(rng.normal(0.0, 2.0, 6))


@given(st.integers(0, 10_000))
def test_a_correction_of_the_world_leaves_the_pose_in_o_where_it_was(seed):
    rng = np.random.default_rng(seed)
    frame = OdometryFrame("always")
    for _ in range(5):
        before, after = pose(rng), pose(rng)
        held = frame.T_W_O.inverse() * before
        frame.correct(before, after, is_recovery=False)
        assert (frame.T_W_O.inverse() * after).equals(held, 1e-9)


def flown(policy, before, after, *, is_recovery, hz=100.0, seconds=60.0):
    """The frame while nothing but one correction happens, and the machine's pose in O at each sample."""
    frame = OdometryFrame(policy)
    frame.correct(before, after, is_recovery=is_recovery)
    poses = [frame.T_W_O.inverse() * after]
    for _ in range(round(seconds * hz)):
        frame.flow(after, 1.0 / hz)
        poses.append(frame.T_W_O.inverse() * after)
    return frame, poses


JUMP = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.02, -0.03, 0.2), np.array([1.0, -0.7, 0.3]))
HERE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, 0.05, 1.0), np.array([30.0, -20.0, 2.0]))


@pytest.mark.parametrize("policy", ["always", "at_recovery"])
@pytest.mark.parametrize("is_recovery", [False, True])
@pytest.mark.parametrize("hz", [50.0, 100.0, 400.0])
def test_no_sample_shows_more_than_two_millimetres_or_two_hundredths_of_a_degree(policy, is_recovery, hz):
    _, poses = flown(policy, HERE, JUMP * HERE, is_recovery=is_recovery, hz=hz, seconds=10.0)
    for before, after in itertools.pairwise(poses):
        step = gtsam.Pose3.Logmap(before.between(after))
        assert np.linalg.norm(before.translation() - after.translation()) < 0.002
        assert np.linalg.norm(step[:3]) < np.radians(0.02)


def test_with_always_the_machine_stays_in_o_and_o_turns_upright_beneath_it():
    frame, poses = flown("always", HERE, JUMP * HERE, is_recovery=False)
    np.testing.assert_allclose(poses[-1].translation(), HERE.translation(), atol=1e-6)
    up = frame.T_W_O.rotation().rotate(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0], atol=1e-6)
    assert abs(frame.T_W_O.rotation().yaw()) > 0.15  # the yaw of the correction stays in T_W_O


def test_with_at_recovery_a_correction_of_every_day_flows_into_o():
    frame, poses = flown("at_recovery", HERE, JUMP * HERE, is_recovery=False, seconds=200.0)  # 4 m at 5 cm/s
    assert frame.T_W_O.equals(gtsam.Pose3(), 1e-6)
    assert poses[-1].equals(JUMP * HERE, 1e-6)


def test_with_at_recovery_the_correction_of_a_recovery_stays_in_t_w_o():
    frame, poses = flown("at_recovery", HERE, JUMP * HERE, is_recovery=True)
    assert frame.T_W_O.equals(JUMP, 1e-9)  # Eq. (11): T_WI after, times T_OI of before, inverted
    assert poses[-1].equals(HERE, 1e-9)


def test_the_pose_in_o_moves_by_the_imus_increment_over_every_correction():
    rng = np.random.default_rng(2)
    drive = Drive()
    config = machine(heading_deg=20.0)  # 3 deg off, so that there is much to correct
    messages = in_order(
        imu(drive, 0.0, 9.0, 100.0, rng), fixes(drive, 0.0, 9.0, 10.0, rng), scans(drive, 0.0, 9.0, 5.0, rng)
    )
    _estimator, outputs = run(config, messages)
    given = [e for e in estimates(outputs) if e.stamp_ns > ns(2.6)]
    jumps = 0
    for before, after in itertools.pairwise(given):
        in_world = before.nav.pose().between(after.nav.pose())
        in_odom = (before.T_W_O.inverse() * before.nav.pose()).between(after.T_W_O.inverse() * after.nav.pose())
        jumped = not before.T_W_O.equals(after.T_W_O, 1e-6)
        jumps += jumped
        if not jumped and before.T_W_O.equals(after.T_W_O, 0.0):
            assert np.linalg.norm(gtsam.Pose3.Logmap(in_world.between(in_odom))) < 1e-9
        # what the machine can do in a sample, corrected or not: 2 m/s and 1.3 rad/s, and the noise of the IMU
        assert np.linalg.norm(in_odom.translation()) < 0.01 * 2.0
        assert np.linalg.norm(gtsam.Rot3.Logmap(in_odom.rotation())) < 0.01 * 1.3 + 5 * 2e-4 * np.sqrt(3) * 0.1
    assert jumps > 50


def published(messages, config):
    recorder = PublishedRecorder(config)
    recorder.run(messages)
    (life,) = recorder.lives()
    return life


def test_o_does_not_step_where_heading_and_velocity_are_corrected():
    rng = np.random.default_rng(2)
    drive = Drive(speed=2.0)
    antenna = [fix for fix in fixes(drive, 0.0, 9.0, 10.0, rng) if not ns(2.4) < fix.stamp_ns < ns(6.0)]
    messages = in_order(imu(drive, 0.0, 9.0, 100.0, rng), antenna)
    life = published(messages, machine(lidar=False, heading_deg=25.0))  # 8 deg off: 0.4 m/s at 3 m/s
    across = np.linalg.norm(np.diff(life.world.velocities, axis=0), axis=1)
    assert across.max() > 0.1  # there was something to correct
    assert list(violations(life, ns(0.0))) == []


@pytest.mark.parametrize("lidar", [False, True])
def test_what_is_driven_while_the_imu_is_silent_is_driven_in_o(lidar):
    rng = np.random.default_rng(2)
    drive = Drive()
    samples = [m for m in imu(drive, 0.0, 9.0, 100.0, rng) if not ns(6.0) < m.stamp_ns < ns(7.0)]
    others = [fixes(drive, 0.0, 9.0, 10.0, rng)] + ([scans(drive, 0.0, 9.0, 5.0, rng)] if lidar else [])
    life = published(in_order(samples, *others), machine(lidar=lidar))
    poses = life.odometry.poses
    k = int(np.argmax(np.diff(poses.stamps_ns)))
    driven = np.linalg.norm(poses.positions[k + 1] - poses.positions[k])
    chord = np.linalg.norm(drive.nav(7.0).position() - drive.nav(6.0).position())
    assert chord > 1.0
    assert abs(driven - chord) < 0.05  # it drives a circle, at a twist that is nearly constant
    assert list(violations(life, ns(0.0))) == []
