"""Ten minutes leave no more behind than half a minute: nodes, links, bias epochs and samples are bounded."""

import numpy as np
import pytest
from motion import Drive, fixes, imu, in_order, machine, miss, ns, run, scans, seconds


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
    from holdfast.estimator.estimator import Estimator

    estimator, sizes = Estimator(config), {}
    for message in messages:
        estimator.process(message)
        if message.sensor == "imu" and estimator.initialised:
            s = estimator._optimiser.graph.main
            sizes[round(seconds(message.stamp_ns), 1)] = (
                len(s),
                len(s._links),
                len(s._window),
                len(estimator._buffer._stamps),
                len(estimator._optimiser.pending),
                s._window.factor_count,
            )
    early = np.max([v for t, v in sizes.items() if 30.0 < t < 130.0], axis=0)
    late = np.max([v for t, v in sizes.items() if t > 500.0], axis=0)
    assert (late <= early * 1.1 + 2).all(), (early, late)
    # a lag of 3 s with nodes of two sensors and at most every half second; a bias and a frame of the lidar per second
    assert late[0] <= 3 * 4 + 2 and late[1] <= late[0] and late[2] <= late[0] + 2 * 6
    assert late[3] <= 1100


def test_settled_states_come_once_each_in_order_and_before_they_leave():
    rng = np.random.default_rng(1)
    drive = Drive()
    messages = in_order(imu(drive, 0.0, 12.0, 100.0, rng), fixes(drive, 0.0, 12.0, 10.0, rng, phase_s=0.0137))
    _, outputs = run(machine(lidar=False), messages)
    settled = [pair for output in outputs for pair in output.smoothed]
    stamps = [stamp for stamp, _ in settled]
    assert len(stamps) > 80 and (np.diff(stamps) > 0).all()
    optimised = sorted({o.optimised.stamp_ns for o in outputs if o.optimised is not None})
    assert {s for s in optimised if ns(2.0) < s < ns(9.0)} <= set(stamps)
    errors = [np.linalg.norm(drive.nav(seconds(s)).position() - nav.position()) for s, nav in settled if s > ns(3.0)]
    assert np.max(errors) < 0.03  # three sigma of one fix, with fixes on both sides
    assert miss(drive, outputs[-1].estimate or next(o.estimate for o in outputs[::-1] if o.estimate))[0] < 0.05
