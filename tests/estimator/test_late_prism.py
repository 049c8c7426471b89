"""A total station that sends what it has measured seconds ago, and leads a machine without GNSS."""

from dataclasses import replace

import numpy as np
import pytest
from motion import ARM, StopAndGo, at, deviation, estimates, imu, in_order, machine, ns, prisms, run, scans

from holdfast.events import EventKind

DRIVE, END_S = StopAndGo(radius_m=4.0, speed=0.35), 75.0
PRISM = {"kind": "prism", "mount": at(ARM), "correlation_s": 0.0}


def led_by_prism(late_s):
    """Return what was told of the prism's clock, and how far the estimates of the last 20 s are off [m]."""
    rng = np.random.default_rng(1)
    by_ns = round(late_s * 1e9)
    measured = prisms(DRIVE, 0.0, END_S, 10.0, rng=rng)
    streams = (
        imu(DRIVE, 0.0, END_S, 100.0, rng),
        scans(DRIVE, 0.0, END_S, 10.0, rng, phase_s=0.0071, delay_s=0.05),
        [replace(one, stamp_ns=one.stamp_ns + by_ns, arrival_ns=one.arrival_ns + max(by_ns, 0)) for one in measured],
    )
    estimator, outputs = run(machine(gnss=False, more={"prism": PRISM}), in_order(*streams))
    told = [one.reason for one in estimator.events if one.kind is EventKind.CALIBRATION and one.sensor == "prism"]
    return told, [deviation(DRIVE, one)[0] for one in estimates(outputs) if one.stamp_ns > ns(END_S - 20.0)]


@pytest.mark.parametrize("late_s", [0.4, 1.2, -1.0])
def test_it_is_dated_anew(late_s):
    """It was refused while the machine moved, and drew the estimate to where that had been."""
    told, off_m = led_by_prism(late_s)
    (words,) = [one.split() for one in told if "beside the motion" in one]
    assert float(words[words.index("add") + 1]) == pytest.approx(-late_s, abs=0.05)
    assert max(off_m) < 0.1


def test_one_that_is_punctual_is_not_accused():
    told, off_m = led_by_prism(0.0)
    assert told == []
    assert max(off_m) < 0.05
