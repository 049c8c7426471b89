"""Ten minutes leave no more behind than half a minute: nodes, samples and what waits are bounded."""

import numpy as np
import pytest
from motion import Drive, deviation, fixes, imu, in_order, machine, ns, optimised, run, scans, seconds

ALWAYS_NS = 2**62


@pytest.mark.slow
def test_ten_minutes_leave_the_window_as_it_was_after_one():
    """Compressed: 10 Hz IMU, 1 Hz GNSS and lidar, a drive at a tenth of the speed."""
    drive = Drive(start_s=5.0, ramp_s=5.0, speed=0.1, tilt=0.3)
    rng = np.random.default_rng(1)
    config = machine(imu_={"max_gap_s": 0.4}, graph={"max_node_interval_s": 0.5}, lidar_={"max_interval_s": 2.0})
    messages = in_order(
        imu(drive, 0.0, 600.0, 10.0, rng),
        fixes(drive, 0.0, 600.0, 1.0, rng, phase_s=0.0137),
        scans(drive, 0.0, 600.0, 1.0, rng, phase_s=0.3071),
    )
    sizes = {}

    def measure(optimiser, stamp_ns):
        waiting = optimiser.waiting.total()
        sizes[seconds(stamp_ns)] = len(optimiser.tracking.graph.main), waiting

    _, _, buffer = optimised(config, messages, measure)
    early = np.max([size for t, size in sizes.items() if 30.0 < t < 130.0], axis=0)
    late = np.max([size for t, size in sizes.items() if t > 500.0], axis=0)
    assert (late <= early * 1.1 + 2).all(), (early, late)
    assert late[0] <= 3 * 4 + 2  # a lag of 3 s with nodes of two sensors and at most every half second
    assert len(buffer.stamps_between(0, ALWAYS_NS)) <= 1100  # samples are dropped a thousand at a time


def test_settled_states_come_once_each_in_order_and_before_they_leave():
    rng = np.random.default_rng(1)
    drive = Drive()
    messages = in_order(imu(drive, 0.0, 12.0, 100.0, rng), fixes(drive, 0.0, 12.0, 10.0, rng, phase_s=0.0137))
    _, outputs = run(machine(lidar=False), messages)
    settled = [pair for output in outputs for pair in output.smoothed]
    stamps = [stamp for stamp, _ in settled]
    assert len(stamps) > 80 and (np.diff(stamps) > 0).all()
    newest = sorted({o.optimised.stamp_ns for o in outputs if o.optimised is not None})
    assert {s for s in newest if ns(2.0) < s < ns(9.0)} <= set(stamps)
    errors = [np.linalg.norm(drive.nav(seconds(s)).position() - nav.position()) for s, nav in settled if s > ns(3.0)]
    assert np.max(errors) < 0.03  # three sigma of one fix, with fixes on both sides
    assert deviation(drive, next(o.estimate for o in outputs[::-1] if o.estimate))[0] < 0.05
