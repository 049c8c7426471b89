"""A total station whose place was typed in wrongly: its prism agrees with itself, and with nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from motion import ARM, Drive, at, deviation, estimates, fixes, imu, in_order, machine, ns, prisms, run, scans, seconds

from holdfast.events import EventKind

ROAD = Drive(start_s=-6.0, ramp_s=4.0, radius_m=8.0, speed=0.2, tilt=0.0, heave_m=0.0)  # 1.6 m/s
PRISM = {"kind": "prism", "mount": at(ARM), "correlation_s": 0.0}
END_S, OUTAGE_S = 60.0, (30.0, 45.0)


def sent(off_m):
    rng = np.random.default_rng(4)
    gnss = fixes(ROAD, 0.0, END_S, 2.0, rng, phase_s=0.0137)
    return in_order(
        imu(ROAD, 0.0, END_S, 50.0, rng),
        [one for one in gnss if not ns(OUTAGE_S[0]) < one.stamp_ns < ns(OUTAGE_S[1])],
        scans(ROAD, 0.0, END_S, 5.0, rng, (0.001, 0.01), phase_s=0.0071),
        [replace(one, position=one.position + off_m) for one in prisms(ROAD, 0.0, END_S, 5.0, rng=rng)],
    )


@pytest.mark.parametrize("off_m", [(1.0, -0.5, 0.3), (80.0, 60.0, 0.0)])
def test_a_start_leaves_it_out_and_an_outage_does_not_let_it_in(off_m):
    """It led an excavator with RTK good by what it was off, or kept it from starting for two minutes."""
    config = machine(heading_deg=None, more={"prism": PRISM})
    estimator, outputs = run(config, sent(off_m))
    (started,) = [event for event in estimator.events if event.kind is EventKind.INITIALISED]
    assert started.reason.endswith("without prism, at odds with the positions")
    assert seconds(started.stamp_ns) < 12.0
    lost = [
        event.reason for event in estimator.events if (event.kind, event.sensor) == (EventKind.RECEIVER_LOST, "prism")
    ]
    assert lost == ["at odds with the positions"]
    off = [deviation(ROAD, one)[0] for one in estimates(outputs) if one.stamp_ns > ns(15.0)]
    assert max(off) < 0.5


def test_one_that_is_right_is_used_from_the_start():
    estimator, _ = run(machine(heading_deg=None, more={"prism": PRISM}), sent((0.0, 0.0, 0.0)))
    kinds = {(event.kind, event.sensor) for event in estimator.events}
    assert (EventKind.RECEIVER_LOST, "prism") not in kinds
