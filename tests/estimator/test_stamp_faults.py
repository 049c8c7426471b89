"""Stamps with which no start is possible are the reason that is told, not what follows from them."""

from dataclasses import replace

import pytest
from motion import Drive, fixes, imu, in_order, machine, ns, run, scans

from holdfast.estimator.stamp_faults import IN_A_ROW, StampFaults

DRIVE = Drive()
END_S = 4.0


def waiting_for(of_imu=lambda ns: ns, of_gnss=lambda ns: ns, of_lidar=lambda ns: ns):
    """What the estimator says it waits for, where the stamps of sensors are a function of what they should be."""
    warped = {"imu": of_imu, "gnss": of_gnss, "lidar": of_lidar}
    sent = in_order(
        imu(DRIVE, 0.0, END_S, 50.0), fixes(DRIVE, 0.0, END_S, 10.0), scans(DRIVE, 0.0, END_S, 5.0, phase_s=0.0071)
    )
    estimator, _ = run(machine(), [replace(one, stamp_ns=warped[one.sensor](one.stamp_ns)) for one in sent])
    return estimator.waiting_for


@pytest.mark.parametrize("at_ns", [0, 1_600_000_000_000_000_000])
def test_stamps_that_stand_still_are_said_to(at_ns):
    """It was said that the IMU had a gap: 5998 samples of it were used."""
    expected = f"the stamps of gnss, lidar do not advance: they stand at {at_ns * 1e-9:.3f} s while messages arrive"
    assert waiting_for(*[lambda _: at_ns] * 3) == expected


def test_only_the_sensor_whose_stamps_stand_still_is_named():
    assert waiting_for(of_gnss=lambda _: 0) == (
        "the stamps of gnss do not advance: they stand at 0.000 s while messages arrive"
    )


@pytest.mark.parametrize("off_s", [0, -5000, 18, 5000])
def test_stamps_that_are_sound_or_by_another_clock_are_no_reason(off_s):
    """A clock that was far from that of the IMU was a reason not to start."""
    assert waiting_for(of_gnss=lambda stamp_ns: stamp_ns + off_s * 10**9) == ""
    assert waiting_for(of_imu=lambda stamp_ns: stamp_ns - off_s * 10**9) == ""


def test_a_sensor_that_is_not_needed_is_no_reason_and_one_stamp_is_no_habit():
    faults = StampFaults()
    for _ in range(IN_A_ROW + 1):
        assert faults.why_not({"gnss"}) == ""
        faults.note("heading", 7)
        faults.note("gnss", ns(0.0))
    assert faults.why_not({"gnss"}) and faults.why_not({"prism"}) == "" and faults.why_not(()) == ""
    faults.note("gnss", ns(1.0))
    assert faults.why_not({"gnss"}) == ""
