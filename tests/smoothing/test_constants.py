"""The optimum over a recording knows mountings and clocks as the causal estimate does; what is right costs nothing."""

import numpy as np
import pytest
from motion import Drive, fixes, imu, in_order, machine, scans, seconds

from holdfast.estimator.estimator import Estimator
from holdfast.smoothing.batch_smoother import BatchSmoother

END_S = 30.0


class StopAndGo(Drive):
    """Its speed swings: on a circle at a constant one, a late stamp looks like another heading."""

    def phase(self, t):
        u, du, ddu = super().phase(t)
        swing = 1.0 + 0.7 * np.cos(2.0 * u)
        return np.array([u + 0.35 * np.sin(2.0 * u), du * swing, ddu * swing - 1.4 * np.sin(2.0 * u) * du**2])


DRIVE = StopAndGo(radius_m=4.0, speed=0.35)


def optimum(fixes_late_s=0.0, lidar_late_s=0.0):
    rng = np.random.default_rng(0)
    sent = in_order(
        imu(DRIVE, 0.0, END_S, 100.0, rng),
        fixes(DRIVE, 0.0, END_S, 10.0, rng, stamp_shift_s=fixes_late_s),
        scans(DRIVE, 0.0, END_S, 5.0, rng, (3e-4, 0.005), phase_s=0.0071, stamp_shift_s=lidar_late_s, delay_s=0.1),
    )
    batch = BatchSmoother(machine())
    estimator = Estimator(machine(), batch)
    for message in sent:
        estimator.process(message)
    batch.stop()
    block = batch.take()[-1]
    track = block.track
    kept = track.times_ns > track.times_ns[0] + 5_000_000_000
    off = [
        position - DRIVE.nav(seconds(time)).position()
        for time, position in zip(track.times_ns[kept].tolist(), track.positions[kept], strict=True)
    ]
    return block.constants, float(np.sqrt((np.array(off) ** 2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def right():
    return optimum()


def test_clocks_that_are_right_are_no_variables(right):
    constants, _ = right
    assert "clock of GNSS" not in constants
    assert not constants["lidar"].is_off


def test_late_stamps_are_estimated_and_cost_little(right):
    constants, rms_m = optimum(fixes_late_s=0.04, lidar_late_s=-0.035)
    for name, true_s in (("clock of GNSS", -0.04), ("lidar", 0.035)):
        assert constants[name].is_off
        assert abs(constants[name].value[-1] - true_s) < 3.0 * constants[name].sigmas[-1] < 0.02
    assert rms_m < 1.5 * right[1] + 0.002
