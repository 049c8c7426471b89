"""O never jumps: T_W_O takes every correction, so that T_O_I moves as the IMU does."""

import itertools

import gtsam
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from motion import Drive, estimates, fixes, imu, in_order, machine, ns, run, scans

from holdfast.estimator.odometry_frame import OdometryFrame


def pose(rng):
    return gtsam.Pose3.Expmap(rng.normal(0.0, 2.0, 6))


@given(st.integers(0, 10_000))
def test_a_correction_of_the_world_leaves_the_pose_in_o_where_it_was(seed):
    rng = np.random.default_rng(seed)
    frame = OdometryFrame()
    for _ in range(5):
        before, after = pose(rng), pose(rng)
        held = frame.T_W_O.inverse() * before
        frame.correct(before, after)
        assert (frame.T_W_O.inverse() * after).equals(held, 1e-9)


def test_o_begins_as_the_world_and_the_first_state_is_no_correction():
    frame = OdometryFrame()
    frame.correct(None, gtsam.Pose3(gtsam.Rot3.Yaw(1.0), np.ones(3)))
    assert frame.T_W_O.equals(gtsam.Pose3(), 0.0)


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


def test_at_the_instant_of_a_correction_the_pose_in_o_is_the_same_before_and_after():
    rng = np.random.default_rng(2)
    drive = Drive()
    messages = in_order(imu(drive, 0.0, 7.0, 100.0, rng), fixes(drive, 0.0, 7.0, 10.0, rng))
    from holdfast.estimator.estimator import Estimator

    estimator, corrections = Estimator(machine(lidar=False, heading_deg=20.0)), []
    for message in messages:
        ready = estimator.initialised
        before = (estimator._predictor._frame.T_W_O, estimator._predictor._nav.pose()) if ready else None
        output = estimator.process(message)
        if before and output.optimised is not None and output.estimate is None:
            after = (estimator._predictor._frame.T_W_O, estimator._predictor._nav.pose())
            held, now = (T_W_O.inverse() * T_W_I for T_W_O, T_W_I in (before, after))
            assert held.equals(now, 1e-9)
            corrections.append(np.linalg.norm(before[1].translation() - after[1].translation()))
    assert len(corrections) > 20 and max(corrections) > 1e-3
