"""Mountings and clocks that are otherwise than the configuration says: found, named, and no longer an error."""

from functools import cache

import gtsam
import numpy as np
import pytest
from motion import (
    ARM_RIGHT,
    T_I_L,
    FigureEight,
    StopAndGo,
    error,
    estimates,
    fixes,
    imu,
    in_order,
    link,
    machine,
    ns,
    run,
    scans,
)

from holdfast.events import EventKind
from holdfast.messages import Heading

DRIVE = StopAndGo(radius_m=4.0, speed=0.35)  # 0.4 to 2.4 m/s
SHAKES_M, PER_PHASE = np.array([0.0012, -0.0012, 0.0005]), 200.0


class Shaking(StopAndGo):
    """Its engine shakes it at up to 19 Hz, so that its velocity says little of how it moves in the next 50 ms."""

    def nav(self, t):
        even, (u, du, _) = super().nav(t), self.phase(t)
        position = even.position() + SHAKES_M * (1.0 - np.cos(PER_PHASE * u))
        return gtsam.NavState(
            even.attitude(), position, even.velocity() + SHAKES_M * PER_PHASE * np.sin(PER_PHASE * u) * du
        )

    def readings(self, t):
        (force, rate), (u, du, ddu) = super().readings(t), self.phase(t)
        rocks = PER_PHASE * np.cos(PER_PHASE * u) * du**2 + np.sin(PER_PHASE * u) * ddu
        return force + self.nav(t).attitude().unrotate(SHAKES_M * PER_PHASE * rocks), rate


SHAKING = Shaking(radius_m=4.0, speed=0.35)
END_S = 40.0
TURNED = np.radians([1.5, -1.0, 2.0])


def drive(
    *,
    turned=(0.0, 0.0, 0.0),
    lidar_late_s=0.0,
    fixes_late_s=0.0,
    seed=0,
    motion=DRIVE,
    sigma=(0.01, 0.01, 0.02),
    **settings,
):
    """The lidar sits otherwise than the configuration says, and stamps are late."""
    rng = np.random.default_rng(seed)
    sent = in_order(
        imu(motion, 0.0, END_S, 100.0, rng),
        fixes(motion, 0.0, END_S, 10.0, rng, sigma, stamp_shift_s=fixes_late_s),
        scans(motion, 0.0, END_S, 5.0, rng, (3e-4, 0.005), phase_s=0.0071, stamp_shift_s=lidar_late_s, delay_s=0.1),
    )
    config = machine(**settings)
    mount = T_I_L * gtsam.Pose3(gtsam.Rot3.Expmap(-np.asarray(turned)), np.zeros(3))
    links = [one for one in config.model_dump()["extrinsics"] if one["child"] != "lidar"]
    data = config.model_dump(exclude_unset=True) | {"extrinsics": [*links, link("imu", "lidar", mount)]}
    estimator, outputs = run(type(config).model_validate(data), sent)
    late = [error(motion, one)[3:6] for one in estimates(outputs) if one.stamp_ns > ns(END_S / 2)]
    found = [event for event in estimator.events if event.kind is EventKind.CALIBRATION]
    return found, float(np.sqrt(np.mean(np.square(late)) * 3.0))


@cache
def right_m(motion=DRIVE, sigma=(0.01, 0.01, 0.02)):
    """The error where all is as the configuration says."""
    return drive(motion=motion, sigma=sigma)[1]


def test_what_is_right_is_not_accused():
    found, _ = drive(seed=1)
    assert found == []


def test_a_lidar_mounted_otherwise_is_named_and_costs_nothing():
    found, rms_m = drive(turned=TURNED)
    assert [event.sensor for event in found][:1] == ["lidar"]
    assert "mounted 2." in found[-1].reason and "otherwise than configured" in found[-1].reason
    assert rms_m < 1.2 * right_m()


def test_what_the_configuration_says_is_known_is_not_doubted():
    found, _ = drive(turned=TURNED, lidar_={"mounting_sigma_deg": 0.0})
    assert not any("mounted" in event.reason for event in found)


@pytest.mark.parametrize("late_s", [0.05, -0.05])
def test_an_offset_is_found_whole_however_the_engine_shakes_the_machine(late_s):
    """Its velocity at a stamp is not its motion over the offset: taken for that, it explains less than there is."""
    sigma = (0.003, 0.003, 0.005)
    found, rms_m = drive(motion=SHAKING, sigma=sigma, fixes_late_s=late_s)
    words = found[-1].reason.split()
    assert float(words[words.index("add") + 1]) == pytest.approx(-late_s, abs=0.005)
    assert rms_m < 1.3 * right_m(SHAKING, sigma)


@pytest.mark.parametrize(("lidar_late_s", "fixes_late_s"), [(0.035, 0.0), (0.0, 0.02), (-0.04, 0.055)])
def test_clocks_that_are_off_are_named_and_cost_nothing(lidar_late_s, fixes_late_s):
    found, rms_m = drive(lidar_late_s=lidar_late_s, fixes_late_s=fixes_late_s)
    assert rms_m < 1.2 * right_m()
    told = {event.sensor: event.reason for event in found}
    for sensor, late_s in (("lidar", lidar_late_s), ("gnss", fixes_late_s)):
        if late_s:
            words = told[sensor].split()
            off_ms = float(words[words.index("ms") - 1]) * (1.0 if "late," in words else -1.0)
            sigma_ms = float(words[words.index("sigma") + 1])
            assert off_ms == pytest.approx(late_s * 1e3, abs=3.0 * sigma_ms) and sigma_ms < 6.0  # when it is told first
        else:
            assert sensor not in told


@cache
def with_heading(off_deg, *, right, figure=False, late_s=0.0):
    """A heading is mounted otherwise than configured, or late; returns events, and the RMS of the heading [deg]."""
    motion, rng = FigureEight(speed=0.15) if figure else DRIVE, np.random.default_rng(5)
    headings = []
    for t in np.arange(0.0503, END_S, 0.1):
        x, y, _ = motion.nav(t).attitude().rotate(np.array([1.0, 0.0, 0.0]))
        yaw_rad = float(np.arctan2(y, x) + np.radians(off_deg) + 0.003 * rng.standard_normal())
        headings.append(Heading(ns(t + late_s), ns(t + max(late_s, 0.3)), "heading", yaw_rad, 0.003))
    streams = [imu(motion, 0.0, END_S, 100.0, rng), fixes(motion, 0.0, END_S, 10.0, rng), headings]
    if right:
        streams.append(fixes(motion, 0.0, END_S, 10.0, rng, arm=ARM_RIGHT, sensor="gnss_right"))
    config = machine(lidar=False, right=right, heading=True, heading_deg=None, heading_={"mounting_yaw_deg": 0.0})
    estimator, outputs = run(config, in_order(*streams))
    late = [one for one in estimates(outputs) if one.stamp_ns > ns(END_S / 2)]
    errors = np.degrees([error(motion, one)[2] for one in late])
    return list(estimator.events), float(np.sqrt(np.mean(errors**2)))


@pytest.mark.parametrize("off_deg", [1.0, 10.0, -90.0, 180.0])
def test_a_heading_beside_two_antennas_that_is_mounted_otherwise_is_named_and_costs_nothing(off_deg):
    events, rms_deg = with_heading(off_deg, right=True)
    told = [one.reason for one in events if one.kind is EventKind.CALIBRATION and one.sensor == "heading"]
    assert rms_deg < max(1.5 * with_heading(0.0, right=True)[1], 0.1)
    if off_deg == 1.0:  # within four sigmas and 0.3 deg
        return
    words = told[-1].split()
    assert np.cos(np.radians(float(words[words.index("add") + 1]) - off_deg)) > np.cos(np.radians(1.0))


@pytest.mark.parametrize("off_deg", [3.0, 10.0, 180.0])
def test_a_heading_beside_one_antenna_that_is_mounted_otherwise_is_found_by_the_motion(off_deg):
    events, rms_deg = with_heading(off_deg, right=False, figure=True)
    assert rms_deg < max(2.0 * with_heading(0.0, right=False, figure=True)[1], 0.5)
    assert any(one.kind is EventKind.CALIBRATION and one.sensor == "heading" for one in events)


def test_a_heading_that_is_mounted_as_configured_is_not_accused():
    for right in (True, False):
        events, rms_deg = with_heading(0.0, right=right, figure=not right)
        assert not any(one.kind in (EventKind.CALIBRATION, EventKind.SENSOR_LOST) for one in events)
        assert rms_deg < 0.25


@pytest.mark.parametrize(("late_s", "right"), [(0.02, True), (0.25, True), (0.1, False)])
def test_a_heading_that_is_late_beside_the_fixes_is_named_and_leaves_them_their_clock(late_s, right):
    events, rms_deg = with_heading(0.0, right=right, figure=not right, late_s=late_s)
    told = [one for one in events if one.kind is EventKind.CALIBRATION]
    assert {one.sensor for one in told} == {"heading"}
    assert rms_deg < max(1.2 * with_heading(0.0, right=right, figure=not right)[1], 0.05)
    words = told[-1].reason.split()
    assert "beside" in words and float(words[words.index("add") + 1]) == pytest.approx(-late_s, abs=0.01)


@pytest.mark.parametrize(("late_s", "right"), [(1.0, True), (0.6, False), (-1.5, False)])
def test_a_heading_that_is_seconds_late_is_dated_anew(late_s, right):
    """It was believed where the machine stood, turned its mount, moved the antennas and bent the gyroscope."""
    events, rms_deg = with_heading(0.0, right=right, figure=not right, late_s=late_s)
    told = [one.reason for one in events if one.kind is EventKind.CALIBRATION and "beside the motion" in one.reason]
    words = told[0].split()
    assert len(told) == 1 and float(words[words.index("add") + 1]) == pytest.approx(-late_s, abs=0.05)
    assert rms_deg < (0.05 if right else 0.3)
