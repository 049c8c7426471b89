"""Stamps with which no start is possible are the reason that is told, not what follows from them."""

from dataclasses import replace

import pytest
from motion import Drive, fixes, imu, in_order, machine, ns, run, scans

from holdfast.estimator.stamp_faults import FAR_NS, IN_A_ROW, StampFaults

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


@pytest.mark.parametrize(("off_s", "way"), [(-5000, "behind"), (61, "ahead of"), (5000, "ahead of")])
def test_a_clock_of_the_imu_that_is_far_from_all_others_is_named(off_s, way):
    """It was said that the last fix had been refused, with its claim, as if that were the fault."""
    reason = waiting_for(of_imu=lambda stamp_ns: stamp_ns + off_s * 10**9)
    assert reason == f"the stamps of the IMU are {abs(off_s)} s {way} those of gnss, lidar"


@pytest.mark.parametrize("off_s", [1.5, 18.0])
def test_a_clock_that_is_ahead_by_leap_seconds_is_told_with_the_key_that_mends_it(off_s):
    """It was said that the last fix had been refused, with its claim."""
    apart = f"{off_s:.1f} s (`time_offset_s` sets them right)"
    ahead = waiting_for(of_gnss=lambda stamp_ns: stamp_ns + round(off_s * 1e9))
    assert ahead == f"the stamps of gnss are {apart} ahead of the IMU's"
    behind = waiting_for(of_imu=lambda stamp_ns: stamp_ns - round(off_s * 1e9))
    assert behind == f"the stamps of the IMU are {apart} behind those of gnss, lidar"


@pytest.mark.parametrize(("off_s", "way"), [(-5000, "behind"), (5000, "ahead of")])
def test_a_receiver_whose_clock_is_far_from_the_others_is_named(off_s, way):
    reason = waiting_for(of_gnss=lambda stamp_ns: stamp_ns + off_s * 10**9)
    assert reason == f"the stamps of gnss are {abs(off_s)} s {way} the IMU's"


def test_sound_stamps_are_no_reason():
    assert waiting_for() == ""


def test_a_sensor_that_is_not_needed_is_no_reason_and_one_stamp_is_no_habit():
    faults = StampFaults()
    for k in range(IN_A_ROW + 1):
        assert faults.why_not({"gnss"}) == ""
        faults.note("heading", 7, 2 * FAR_NS)
        faults.note("gnss", ns(0.0), 2 * FAR_NS if k else None)
    assert faults.why_not({"gnss"}) and faults.why_not({"prism"}) == "" and faults.why_not(()) == ""
    faults.note("gnss", ns(1.0), 0)
    assert faults.why_not({"gnss"}) == ""
