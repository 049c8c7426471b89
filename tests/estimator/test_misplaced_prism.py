"""A total station whose place was typed in wrongly: its prism agrees with itself, and with nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from motion import (
    ARM,
    ARM_RIGHT,
    Drive,
    at,
    deviation,
    estimates,
    fixes,
    imu,
    in_order,
    machine,
    ns,
    prisms,
    run,
    scans,
    seconds,
)

from holdfast.events import EventKind

ROAD = Drive(start_s=-6.0, ramp_s=4.0, radius_m=8.0, speed=0.2, tilt=0.0, heave_m=0.0)  # 1.6 m/s
PRISM = {"kind": "prism", "mount": at(ARM), "correlation_s": 0.0}
END_S, OUTAGE_S = 60.0, (30.0, 45.0)


def sent(off_m, hz=2.0):
    rng = np.random.default_rng(4)
    gnss = fixes(ROAD, 0.0, END_S, hz, rng, phase_s=0.0137)
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


def test_an_estimate_that_has_drifted_does_not_vouch_for_it():
    """In an outage the estimate had drifted by as much as the prism was off, and was led by it from then on."""
    gnss_right = fixes(ROAD, 0.0, OUTAGE_S[0], 2.0, np.random.default_rng(5), sensor="gnss_right", arm=ARM_RIGHT)
    messages = [one for one in sent((1.0, -0.5, 0.3)) if one.sensor != "lidar"]
    config = machine(heading_deg=None, lidar=False, right=True, more={"prism": PRISM})
    estimator, outputs = run(config, in_order(messages, gnss_right))
    regained = [event for event in estimator.events if event.kind is EventKind.RECEIVER_REGAINED]
    assert "prism" not in {event.sensor for event in regained}
    off = [deviation(ROAD, one)[0] for one in estimates(outputs) if one.stamp_ns > ns(OUTAGE_S[1] + 5.0)]
    assert max(off) < 0.3


def test_what_is_missing_beside_it_is_told():
    """On a circle one antenna tells no heading; it said that GNSS and IMU disagree, and to look for wrong units."""
    messages = [one for one in sent((1.0, -0.5, 0.3)) if one.sensor != "lidar" and one.stamp_ns < ns(10.0)]
    estimator, _ = run(machine(heading_deg=None, lidar=False, more={"prism": PRISM}), messages)
    assert estimator.waiting_for.startswith("heading is known to ")
    assert estimator.waiting_for.endswith(" deg, 10.0 deg are needed, without prism, at odds with the positions")


def test_a_fix_that_is_elsewhere_does_not_hide_it_from_a_start():
    """With one the rest did not fit either: it waited for 20 s, or took all, and the prism led for two minutes."""
    messages = sent((1.0, -0.5, 0.3), hz=1.0)
    first = next(k for k, one in enumerate(messages) if one.sensor == "gnss" and one.stamp_ns > ns(2.0))
    messages[first] = replace(messages[first], latitude_deg=messages[first].latitude_deg + 2e-5)  # 2 m
    estimator, outputs = run(machine(heading_deg=None, more={"prism": PRISM}), messages)
    (started,) = [event for event in estimator.events if event.kind is EventKind.INITIALISED]
    assert started.reason.endswith("without prism, at odds with the positions")
    assert seconds(started.stamp_ns) < 6.0
    assert max(deviation(ROAD, one)[0] for one in estimates(outputs) if one.stamp_ns > ns(20.0)) < 0.5
