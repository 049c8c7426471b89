"""An odometry in its process beside what is read: the same poses however the process fares, losses counted."""

import os
import signal
import time
from contextlib import closing

import gtsam
import numpy as np
import pytest
from bags import HUMBLE
from yard import ARM, START_NS, error, message, sweep

from holdfast.errors import EstimatorError
from holdfast.lidar_odometry.in_step import InStep
from holdfast.lidar_odometry.inertial_guide import ImuMount, ImuSamples
from holdfast.lidar_odometry.process import ScanProcess
from holdfast.lidar_odometry.scan_odometry import ScanOdometry, Settings
from holdfast.messages import ImuSample
from holdfast.recording.kinds.scans import point_cloud

pytest.importorskip("small_gicp")

PERIOD_NS = 200_000_000
ON_THE_AXIS = gtsam.Pose3(gtsam.Rot3(), ARM).matrix()
MOUNT = ImuMount(ON_THE_AXIS, 0, 2e-4, 1e-5, 0.01, 0.003)


def turning(t):
    return 0.1 * np.asarray(t)


def scan(number, angle=turning, late_ns=210_000_000):
    rng = np.random.default_rng(number)
    swept = message(HUMBLE, sweep(number, rng, angle))
    return point_cloud(START_NS + number * PERIOD_NS, START_NS + number * PERIOD_NS + late_ns, "lidar", swept)


SCANS = [scan(k) for k in range(6)]


def samples(bias=0.0, seconds=1.4):
    """What a gyroscope measures of the turn, at 100 Hz."""
    for k in range(round(seconds * 100)):
        stamp_ns = START_NS + k * 10_000_000
        yield ImuSample(stamp_ns, stamp_ns, "imu", np.array([0.0, 0.0, 0.1 + bias]), np.array([0.0, 0.0, 9.81]))


def poses(odometry, scans=SCANS, between=lambda _: None):
    """The poses that are due as scan after scan arrives."""
    found, rates = [], list(samples())
    for number, one in enumerate(scans):
        while rates and rates[0].arrival_ns <= one.arrival_ns:
            odometry.add_sample(rates.pop(0))
        found += odometry.due(one.arrival_ns)
        odometry.add_scan(one)
        between(number)
    return found + list(odometry.due())


def test_the_process_gives_the_poses_of_the_value_machine_to_the_bit():
    machine, expected, rates = ScanOdometry(Settings(imu=MOUNT)), [], list(samples())
    for one in SCANS:
        fresh = [sample for sample in rates if sample.arrival_ns <= one.arrival_ns]
        rates = rates[len(fresh) :]
        expected.append(machine.register(one, ImuSamples.of(fresh)))
    with closing(InStep(Settings(imu=MOUNT), 0.08)) as odometry:
        found = poses(odometry)
    assert [due.arrival_ns - one.arrival_ns for due, one in zip(found, SCANS, strict=True)] == [80_000_000] * 6
    for due, pose in zip(found, expected, strict=True):
        np.testing.assert_array_equal(due.registered.T_L0_L, pose.T_L0_L)
        assert due.registered.stamp_ns == pose.stamp_ns
        assert due.registered.is_guided


def test_a_killed_process_costs_the_scans_that_it_had_and_a_successor_goes_on_where_it_was():
    with closing(InStep(Settings(), 0.08)) as odometry:

        def kill(number):
            if number == 3:
                os.kill(odometry.pid, signal.SIGKILL)
                time.sleep(0.1)

        found = poses(odometry, between=kill)
        account = odometry.account
    assert 1 <= account.lost <= 2
    assert "was killed by SIGKILL" in account.fault
    assert len(found) == account.poses == 6 - account.lost
    [began] = [due.registered for due in found if due.registered.restarted]
    before = max(
        (due.registered for due in found if due.registered.stamp_ns < began.stamp_ns), key=lambda r: r.stamp_ns
    )
    np.testing.assert_array_equal(began.T_L0_L, before.T_L0_L)


def test_a_process_that_ends_again_and_again_is_an_error_and_not_a_loop():
    class Doomed(ScanProcess):
        def submit(self, *arguments):
            os.kill(self.pid, signal.SIGKILL)
            super().submit(*arguments)

    with closing(InStep(Settings(), 0.08, make=Doomed)) as odometry, pytest.raises(EstimatorError, match="SIGKILL"):
        poses(odometry, SCANS * 3)


def test_a_library_that_throws_ends_it_in_one_line_where_nobody_wants_a_successor():
    with (
        closing(InStep(Settings(scan_voxel_m=-1.0, map_voxel_m="none"), 0.08, restarts=False)) as odometry,  # type: ignore[arg-type]
        pytest.raises(EstimatorError, match="lidar odometry by small-gicp: failed: ") as raised,
    ):
        poses(odometry)
    assert "\n" not in str(raised.value)


def test_the_bias_of_the_gyroscope_is_found_without_anyone_telling_it():
    machine, rates = ScanOdometry(Settings(imu=MOUNT)), list(samples(bias=0.02, seconds=3.0))
    for one in [scan(k) for k in range(12)]:
        fresh = [sample for sample in rates if sample.arrival_ns <= one.arrival_ns]
        rates = rates[len(fresh) :]
        pose = machine.register(one, ImuSamples.of(fresh))
    assert machine.gyroscope_bias[2] == pytest.approx(0.02, abs=0.004)
    assert np.abs(machine.gyroscope_bias[:2]).max() < 0.004
    assert pose.is_guided


def fast(t):
    """A cabin that is slewing with 1 rad/s when the first scan begins, and goes on."""
    return 1.0 * np.asarray(t)


def at_one_radian(rates_late_ns=0):
    for k in range(260):
        stamp_ns = START_NS - 200_000_000 + k * 10_000_000
        yield ImuSample(
            stamp_ns, stamp_ns + rates_late_ns, "imu", np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 9.81])
        )


@pytest.mark.parametrize(("late_ns", "missing"), [(210_000_000, ()), (400_000_000, ()), (210_000_000, (4,))])
def test_a_slew_of_one_radian_a_second_late_scans_and_a_missing_one_hold(late_ns, missing):
    machine, rates, errors, first = ScanOdometry(Settings(imu=MOUNT)), list(at_one_radian()), [], None
    for number in range(9):
        one = scan(number, fast, late_ns)
        fresh = [sample for sample in rates if sample.arrival_ns <= one.arrival_ns]
        rates = rates[len(fresh) :]
        if number in missing:
            continue
        pose = machine.register(one, ImuSamples.of(fresh))
        first = first or pose
        assert not pose.restarted
        errors.append(error(pose, first, fast))
    errors = np.array(errors)
    # the lever of the lidar, 0.85 m/s on it, is deskewed from the first sweep on
    assert np.degrees(np.abs(errors[:, :3])).max() < 0.06
    assert np.linalg.norm(errors[:, 3:], axis=1).max() < 0.02
