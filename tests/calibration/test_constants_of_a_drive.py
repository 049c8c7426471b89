"""Clocks, mountings, noise and drift of a drive whose truth is known: found within their own sigmas."""

import gtsam
import numpy as np
import pytest
from motion import T_I_L, StopAndGo, fixes, imu, in_order, link, machine, ns, scans

from holdfast.calibration.clocks import clocks
from holdfast.calibration.constants import is_off
from holdfast.calibration.evidence import collected
from holdfast.calibration.lever_arms import lever_arms, with_estimated_arms
from holdfast.calibration.mountings import mountings
from holdfast.calibration.odometry_noise import odometry_noise
from holdfast.calibration.scales import scales
from holdfast.messages import Heading
from holdfast.sensors.clock import IF_RIGHT_S

DRIVE = StopAndGo(radius_m=4.0, speed=0.35)  # 0.4 to 2.4 m/s
END_S = 40.0
TURNED = np.radians([1.5, -1.0, 2.0])
JITTER = 3e-4, 0.005  # [rad, m] of a pose


def config_of(turned=(0.0, 0.0, 0.0), **settings):
    config = machine(**settings)
    mount = T_I_L * gtsam.Pose3(gtsam.Rot3.Expmap(-np.asarray(turned)), np.zeros(3))
    links = [one for one in config.model_dump()["extrinsics"] if one["child"] != "lidar"]
    data = config.model_dump(exclude_unset=True) | {"extrinsics": [*links, link("imu", "lidar", mount)]}
    return type(config).model_validate(data)


def drive(config, *, lidar_late_s=0.0, fixes_late_s=0.0, seed=0, ignored=(), jitter=JITTER, headings=()):
    rng = np.random.default_rng(seed)
    sent = in_order(
        headings,
        imu(DRIVE, 0.0, END_S, 100.0, rng),
        fixes(DRIVE, 0.0, END_S, 10.0, rng, stamp_shift_s=fixes_late_s),
        scans(DRIVE, 0.0, END_S, 5.0, rng, jitter, phase_s=0.0071, stamp_shift_s=lidar_late_s, delay_s=0.1),
    )
    return collected("drive", config, sent, ignored=ignored)


def named(found, key):
    return [one for one in found.estimates if one.key.endswith(key)]


def test_late_stamps_are_found_within_three_sigmas_and_written():
    config = config_of()
    found = clocks([drive(config, lidar_late_s=-0.035, fixes_late_s=0.03)], config, config)
    by_sensor = {one.what: one for one in found.estimates}
    for name, true_s in (("gnss", -0.03), ("lidar", 0.035)):
        one = by_sensor[name]
        assert abs(one.after - true_s) < 3.0 * one.sigma and one.sigma < 0.005
        assert one.is_written
    assert {change.path[1] for change in found.changes} >= {"gnss", "lidar"}


@pytest.mark.slow
def test_clocks_that_are_right_are_left_alone():
    config = config_of()
    found = clocks([drive(config, seed=1)], config, config)
    assert found.estimates and not found.changes
    assert all("as configured" in one.reason for one in found.estimates)


@pytest.mark.slow
def test_two_recordings_know_a_clock_better_than_one():
    config = config_of()
    runs = [drive(config, seed=seed, lidar_late_s=-0.035) for seed in (0, 1)]
    one, both = (
        next(row for row in clocks(of, config, config).estimates if row.what == "lidar") for of in (runs[:1], runs)
    )
    assert both.sigma < one.sigma


def test_a_lidar_mounted_otherwise_is_turned_in_the_file():
    config = config_of(turned=TURNED)
    found = mountings([drive(config)], config, config)
    turned = np.radians([one.after for one in found.estimates])
    sigmas = np.radians([one.sigma for one in found.estimates])
    assert (np.abs(turned - TURNED) < 3.0 * sigmas).all() and (np.degrees(sigmas) < 0.4).all()
    assert len(found.changes) == 1


def headings_of(off_deg=0.0, late_s=0.0):
    rng, headings = np.random.default_rng(6), []
    for t in np.arange(0.0503, END_S, 0.2):
        x, y, _ = DRIVE.nav(t).attitude().rotate(np.array([0.0, 1.0, 0.0]))
        yaw_rad = float(np.arctan2(y, x) + np.radians(off_deg) + 0.01 * rng.standard_normal())
        headings.append(Heading(ns(t + late_s), ns(t + late_s), "heading", yaw_rad, 0.01))
    return headings


def test_the_offset_of_a_heading_is_that_of_fixes_and_its_own():
    config = config_of(heading=True, heading_={"mounting_yaw_deg": 90.0})
    found = clocks([drive(config, fixes_late_s=0.03, headings=headings_of(late_s=0.15))], config, config)
    by_sensor = {one.what: one for one in found.estimates}
    for name, late_s in (("gnss", 0.03), ("heading", 0.15)):
        one = by_sensor[name]
        assert abs(one.after + late_s) < 3.0 * one.sigma and one.sigma < 0.01
        assert one.is_written
    assert {change.path[1]: change.value for change in found.changes}["heading"] == pytest.approx(-0.15, abs=0.03)


@pytest.mark.parametrize("off_deg", [4.0, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_heading_mounted_otherwise_is_turned_in_the_file(off_deg):
    config = config_of(heading=True, heading_={"mounting_yaw_deg": 90.0})
    found = mountings([drive(config, headings=headings_of(off_deg))], config, config)
    one = next(row for row in found.estimates if row.what == "heading")
    assert abs(one.after - 90.0 - off_deg) < 3.0 * one.sigma and one.sigma < 0.6
    written = [(change.path[1:], change.value) for change in found.changes if change.path[0] == "sensors"]
    assert written == ([(("heading", "mounting_yaw_deg"), round(one.after, 2))] if off_deg else [])


@pytest.mark.parametrize("true", [0.96, pytest.param(1.0, marks=pytest.mark.slow)])
def test_distances_that_are_too_long_are_found_and_written(true):
    """The file says that they are to be multiplied by one."""
    config = config_of(lidar_={"scale": 1.0 / true})
    (found,) = scales([drive(config)], config, config).estimates
    assert abs(found.after - 1.0) < 3.0 * found.sigma and found.sigma < 0.01
    assert found.is_written == (true != 1.0)


@pytest.mark.slow
def test_what_was_not_seen_is_said_and_not_written():
    config = config_of(turned=TURNED, lidar_={"mounting_sigma_deg": 0.05})
    found = mountings([drive(config)], config, config)
    assert not found.changes
    assert all(one.reason.startswith("not observable") for one in found.estimates if not one.is_observable)
    assert any(not one.is_observable for one in found.estimates)


def test_the_noise_of_an_odometry_that_does_not_drift_is_found_and_its_drift_is_small():
    config = config_of()
    found = odometry_noise([drive(config, ignored=["lidar"])], config)
    (translation,), (rotation,) = named(found, "translation_sigma_m"), named(found, "rotation_sigma_rad")
    assert translation.after == pytest.approx(0.005 * np.sqrt(2.0), rel=0.3)
    assert rotation.after == pytest.approx(3e-4 * np.sqrt(2.0), rel=0.5)
    assert named(found, "drift_m_per_sqrt_m")[0].after < 0.02


@pytest.mark.slow
def test_an_odometry_five_times_noisier_is_written_as_such():
    config = config_of()
    found = odometry_noise([drive(config, ignored=["lidar"], jitter=(0.005, 0.07))], config)
    (translation,) = named(found, "translation_sigma_m")
    assert translation.is_written
    assert translation.after == pytest.approx(0.07 * np.sqrt(2.0), rel=0.3)


def test_an_offset_that_filters_in_sensors_explain_is_none():
    assert not is_off(0.008, 0.0005, 0.03, IF_RIGHT_S)
    assert is_off(0.02, 0.001, 0.03, IF_RIGHT_S)
    assert not is_off(0.02, 0.02, 0.03, IF_RIGHT_S)


@pytest.mark.slow
def test_a_lever_arm_that_was_measured_wrongly_is_found_where_the_machine_turns():
    config, off = config_of(), np.array([0.05, -0.04, 0.0])
    wrong = [
        one.model_copy(update={"translation_m": tuple(np.add(one.translation_m, -off).tolist())})
        if one.child == "gnss"
        else one
        for one in config.extrinsics
    ]
    given = config.model_copy(update={"extrinsics": tuple(wrong)})
    with_arms, _ = with_estimated_arms(given)
    found = lever_arms([drive(with_arms)], given, with_arms)
    for one, true in zip(found.estimates, off, strict=True):
        assert abs(one.after - true) < 3.0 * one.sigma, one.what
    assert [one.is_observable for one in found.estimates[:2]] == [True, True]
    assert len(found.changes) == 1 and found.changes[0].path[-1] == "translation_m"
