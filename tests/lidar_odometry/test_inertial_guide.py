"""The guide of an odometry: which samples it takes, and that it says when it cannot tell."""

import numpy as np
import pytest
from yard import START_NS

from holdfast.config.load import parse_config
from holdfast.lidar_odometry.inertial_guide import MEMORY_NS, ImuMount, ImuSamples, InertialGuide, imu_mount
from holdfast.lidar_odometry.sweep import Sweep

MS = 1_000_000
FORCE = np.array([0.1, 0.2, 9.8])
OFFSETS_S = np.linspace(0.0, 0.1, 11)
SWEEP = Sweep(START_NS, "lidar", np.ones((11, 3)), OFFSETS_S)


AS_THE_IMU = np.eye(4)


def inertial_guide(offset_ns=0, T_I_L=AS_THE_IMU):
    return InertialGuide(ImuMount(T_I_L, offset_ns, 2e-4, 1e-5, 0.01, 0.003))


def samples(*rows):
    """(ms after the start of the sweep, rate about z)."""
    stamps_ns = np.array([START_NS + round(at_ms * MS) for at_ms, _ in rows], np.int64)
    angular = np.array([[0.0, 0.0, rate] for _, rate in rows]).reshape(-1, 3)
    return ImuSamples(stamps_ns, angular, np.tile(FORCE, (len(rows), 1)))


def every(ms, begin_ms, end_ms):
    return samples(*((at, 0.1) for at in np.arange(begin_ms, end_ms + 1e-6, ms)))


def test_samples_that_go_back_repeat_or_are_not_finite_are_passed_over():
    guide = inertial_guide()
    guide.add(samples((-10, 1.0), (0, 2.0), (-5, 9.0), (0, 9.0), (50, np.nan), (100, 3.0)))
    guide.add(samples((90, 9.0), (110, 4.0)))
    guide.add(samples())
    rates = guide.rates(SWEEP)
    assert rates.angular[:, 2].tolist() == [1.0, 2.0, 3.0, 4.0]
    np.testing.assert_allclose(rates.times_s, [-0.01, 0.0, 0.1, 0.11])


def test_a_sweep_that_it_did_not_measure_whole_is_not_guided():
    for begin_ms, end_ms, is_guided in ((-200, 100, True), (-200, 75, True), (-200, 60, False), (40, 200, False)):
        guide = inertial_guide()
        guide.add(every(10, begin_ms, end_ms))
        assert (guide.rates(SWEEP) is not None) is is_guided, (begin_ms, end_ms)
    assert inertial_guide().rates(SWEEP) is None


def test_readings_are_on_the_clock_and_in_the_axes_of_the_lidar():
    R_I_L = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # z of I is y of L
    T_I_L = np.eye(4)
    T_I_L[:3, :3], T_I_L[:3, 3] = R_I_L, [0.0, 0.0, 2.0]
    guide = inertial_guide(offset_ns=5 * MS, T_I_L=T_I_L)
    guide.add(every(10, -100, 200))
    rates = guide.rates(SWEEP)
    np.testing.assert_allclose(rates.times_s[0], -0.095)
    np.testing.assert_allclose(rates.angular, np.tile(np.array([0.0, 0.0, 0.1]) @ R_I_L, (31, 1)))
    np.testing.assert_allclose(rates.forces[0], FORCE @ R_I_L)
    np.testing.assert_allclose(rates.lever, [0.0, 2.0, 0.0])


def test_it_forgets_what_no_scan_can_need():
    guide = inertial_guide()
    for begin_ms in range(0, 60_000, 500):
        guide.add(every(10, begin_ms, begin_ms + 490))
    assert len(guide._samples.stamps_ns) <= MEMORY_NS / (10 * MS) + 1


def test_the_mount_is_that_of_the_configuration():
    config = parse_config("""
sensors:
  imu: {kind: imu, topic: /imu, time_offset_s: 0.01}
  lidar: {kind: scans, topic: /points, time_offset_s: -0.02}
extrinsics: [{parent: imu, child: lidar, translation_m: [0, 0, 1], rotation_rpy_deg: [0, 0, 90]}]
""")
    mount = imu_mount(config, "lidar")
    assert mount.offset_ns == pytest.approx(30 * MS)
    np.testing.assert_allclose(mount.T_I_L, config.T_I("lidar"))
