"""An engine that turns nearly as often as the IMU measures: its samples swing slowly, and the machine does not."""

import numpy as np
from faults import swung
from motion import ARM, ARM_RIGHT, Drive, deviation, estimates, fixes, imu, in_order, machine, ns, run, seconds

from holdfast.events import EventKind

ROAD = Drive(radius_m=8.0, speed=0.3)  # 2.4 m/s
SINCE_S, FOUND_S, END_S = 15.0, 25.0, 50.0


def antenna_off_m(estimate):
    """Where the antenna is says a fix, whatever becomes of the heading."""
    true = ROAD.pose(seconds(estimate.stamp_ns)).transformFrom(ARM)
    return np.linalg.norm(estimate.nav.pose().transformFrom(ARM) - true)


def test_good_fixes_are_not_refused_for_long():
    """The estimate began anew every other second to the end of the drive, and was up to 50 m off in between."""
    rng = np.random.default_rng(0)
    messages = in_order(
        swung(imu(ROAD, 0.0, END_S, 100.0, rng), since_s=SINCE_S),
        fixes(ROAD, 0.0, END_S, 5.0, rng),
    )
    estimator, outputs = run(machine(lidar=False), messages)
    (told, *_) = [event for event in estimator.events if (event.kind, event.sensor) == (EventKind.NOISE, "imu")]
    assert "swings as no receiver sees" in told.reason and SINCE_S < seconds(told.stamp_ns) < FOUND_S
    late = [event.kind for event in estimator.events if event.stamp_ns > ns(FOUND_S)]
    assert EventKind.BEGUN_ANEW not in late and EventKind.RECEIVER_LOST not in late
    off = [antenna_off_m(one) for one in estimates(outputs) if one.stamp_ns > ns(FOUND_S)]
    assert np.sqrt(np.mean(np.square(off))) < 0.3  # what the swing is until the next fix


def test_antennas_that_were_moved_to_explain_the_swing_are_put_back_when_it_is_known():
    """On a circle nothing tells an arm from a sideways pull: for good the antennas were 8 m elsewhere."""
    rng = np.random.default_rng(1)
    left, right = (
        fixes(ROAD, 0.0, END_S, 5.0, rng),
        fixes(ROAD, 0.0, END_S, 5.0, rng, sensor="gnss_right", arm=ARM_RIGHT),
    )
    messages = in_order(swung(imu(ROAD, 0.0, END_S, 100.0, rng), since_s=3.0), left, right)
    estimator, outputs = run(machine(lidar=False, right=True, heading_deg=None), messages)
    events = [(event.kind, seconds(event.stamp_ns)) for event in estimator.events]
    told_s = max(t for kind, t in events if kind is EventKind.NOISE)
    assert any(kind is EventKind.BEGUN_ANEW and told_s <= t < told_s + 5.0 for kind, t in events)
    off = [deviation(ROAD, one)[0] for one in estimates(outputs) if one.stamp_ns > ns(30.0)]
    assert np.sqrt(np.mean(np.square(off))) < 0.3
