"""A total station, and markers, that send what they measured seconds ago, and lead a machine without GNSS."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import (
    ARM,
    NOT_TURNED,
    StopAndGo,
    at,
    deviation,
    estimates,
    imu,
    in_order,
    machine,
    ns,
    poses,
    prisms,
    run,
    scans,
)

from holdfast.events import EventKind

DRIVE, END_S = StopAndGo(radius_m=4.0, speed=0.35), 75.0
PRISM = {"kind": "prism", "mount": at(ARM), "correlation_s": 0.0}
MARKER = {"kind": "pose", "mount": at([0.0, 0.0, 0.0]), "correlation_s": 0.0}
ELSEWHERE = gtsam.Pose3(gtsam.Rot3.Yaw(0.5), np.array([3.0, -2.0, 0.1]))
OF_THE_SITE = MARKER | {"offset_sigma_m": 100.0, "offset_sigma_deg": 180.0}


def led(late_s, measured, config, rng):
    """Return what was told of the clock, and how far the estimates of the last 20 s are off [m]."""
    by_ns, (sensor,) = round(late_s * 1e9), {one.sensor for one in measured}
    streams = (
        imu(DRIVE, 0.0, END_S, 100.0, rng),
        scans(DRIVE, 0.0, END_S, 10.0, rng, phase_s=0.0071, delay_s=0.05),
        [replace(one, stamp_ns=one.stamp_ns + by_ns, arrival_ns=one.arrival_ns + max(by_ns, 0)) for one in measured],
    )
    estimator, outputs = run(machine(gnss=False, more={sensor: config}), in_order(*streams))
    told = [one.reason for one in estimator.events if one.kind is EventKind.CALIBRATION and one.sensor == sensor]
    return told, [deviation(DRIVE, one)[0] for one in estimates(outputs) if one.stamp_ns > ns(END_S - 20.0)]


def led_by_prism(late_s):
    rng = np.random.default_rng(1)
    return led(late_s, prisms(DRIVE, 0.0, END_S, 10.0, rng=rng), PRISM, rng)


def led_by_markers(late_s, config=MARKER, T_W_F=NOT_TURNED):
    rng = np.random.default_rng(1)
    return led(late_s, poses(DRIVE, 0.0, END_S, 10.0, T_W_F, rng=rng), config, rng)


@pytest.mark.parametrize("lead", [led_by_prism, led_by_markers])
@pytest.mark.parametrize("late_s", [0.4, 1.2, -1.0])
def test_it_is_dated_anew(lead, late_s):
    """It was refused while the machine moved, and drew the estimate to where that had been."""
    told, off_m = lead(late_s)
    (words,) = [one.split() for one in told if "beside the motion" in one]
    assert float(words[words.index("add") + 1]) == pytest.approx(-late_s, abs=0.05)
    assert max(off_m) < 0.1


@pytest.mark.parametrize(("lead", "most_m"), [(led_by_prism, 0.05), (led_by_markers, 0.1)])  # of noise 5 and 50 mm
def test_one_that_is_punctual_is_not_accused(lead, most_m):
    told, off_m = lead(0.0)
    assert told == []
    assert max(off_m) < most_m


@pytest.mark.parametrize("late_s", [0.0, 1.2])
def test_so_are_markers_in_a_frame_that_nobody_knows(late_s):
    told, _ = led_by_markers(late_s, OF_THE_SITE, ELSEWHERE)
    found = [one for one in told if "beside the motion" in one]
    assert len(found) == (late_s > 0.0)
