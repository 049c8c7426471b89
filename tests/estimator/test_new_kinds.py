"""Twist, GNSS velocity, nonholonomic, prism, pose, height, several odometries: what each is for, what faults do."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import (
    ARM,
    ARM_RIGHT,
    HEADING_DEG,
    Drive,
    at,
    deviation,
    estimates,
    fixes,
    heights,
    imu,
    in_order,
    machine,
    ns,
    optimised,
    poses,
    prisms,
    run,
    scans,
    seconds,
    twists,
    velocities,
)

from holdfast.events import EventKind, Health, Outcome

CURVE = Drive(tilt=0.3)
ROAD = Drive(radius_m=15.0, speed=0.2, tilt=0.0, roll_rad=0.0, pitch_rad=0.0, heave_m=0.0)  # 3 m/s, x axis ahead
AXLE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.05, -0.1, 0.4), np.array([-1.0, 0.3, -0.9]))
WHEELS = {
    "kind": "twist",
    "mount": AXLE,
    "axes": ("x", "y", "z"),
    "slip_ratio": 0.0,
    "sigma_m_s": 0.02,
    "correlation_s": 0.0,
}
DOPPLER = {"kind": "gnss_velocity", "frame": "gnss", "correlation_s": 0.0}
PRISM = {"kind": "prism", "mount": at(ARM), "correlation_s": 0.0}
MARKER = {"kind": "pose", "mount": at([0.0, 0.0, 0.0]), "correlation_s": 0.0}
LASER = {"kind": "height", "mount": at(ARM), "correlation_s": 0.0}
FIX_M = 0.05  # five sigma of one fix


def kinds(log, sensor):
    """What happened to a sensor, rejections left out."""
    return [event.kind for event in log.events if event.sensor == sensor and event.kind is not EventKind.REJECTED]


def worst_m(drive, outputs, start_s, end_s):
    return max(deviation(drive, e)[0] for e in estimates(outputs) if ns(start_s) < e.stamp_ns < ns(end_s))


def silent(messages, start_s, end_s):
    return [m for m in messages if not ns(start_s) < m.stamp_ns < ns(end_s)]


# --- twist ------------------------------------------------------------------------------------------------------------


def wheeled(scale=1.0, end_s=30.0, outage_s=(10.0, 28.0), bias=(0.03, -0.02, 0.01, 0.0, 0.0, 0.0)):
    rng = np.random.default_rng(1)
    return in_order(
        imu(CURVE, 0.0, end_s, 100.0, rng, bias=bias),
        silent(fixes(CURVE, 0.0, end_s, 10.0, rng, phase_s=0.0137), *outage_s),
        twists(CURVE, 0.0, end_s, 10.0, AXLE, scale, rng),
    )


def test_wheels_alone_bound_an_outage():
    """18 s at 1.5 m/s are 27 m; the IMU alone has half a metre after a few seconds."""
    config = machine(lidar=False, more={"wheels": WHEELS})
    _, outputs = run(config, wheeled())
    assert worst_m(CURVE, outputs, 10.0, 28.0) < 0.01 * 27.0
    _, alone = run(machine(lidar=False), [m for m in wheeled() if m.sensor != "wheels"])
    assert worst_m(CURVE, alone, 10.0, 28.0) > 4.0 * worst_m(CURVE, outputs, 10.0, 28.0)


def test_a_scale_factor_of_the_wheels_is_found_while_gnss_is_there_and_holds_without_it():
    config = machine(lidar=False, more={"wheels": WHEELS})
    found = {}

    def note(optimiser, stamp_ns):
        found[seconds(stamp_ns)] = optimiser.tracking.graph.published.parameters.estimate("wheels")

    optimised(config, wheeled(1.03), note)
    for end_s in (10.0, 28.0):
        (scale,), (sigma,) = found[max(t for t in found if t < end_s)]
        # 20 mm/s of noise at 1.5 m/s, over 6 s at 10 Hz, beside what GNSS knows of the speed
        assert abs(scale - 0.03) < 4.0 * sigma and sigma < 0.003
    _, outputs = run(config, wheeled(1.03))
    assert worst_m(CURVE, outputs, 10.0, 28.0) < 0.015 * 27.0


def test_a_frozen_twist_is_lost_by_name_harms_nothing_and_is_regained():
    stop = Drive(tilt=0.0, heave_m=0.0, start_s=6.0)
    rng = np.random.default_rng(1)
    wheels = twists(stop, 0.0, 16.0, 10.0, AXLE, 1.0, rng)
    frozen = [replace(m, linear=wheels[0].linear) if ns(5.0) < m.stamp_ns < ns(11.0) else m for m in wheels]
    messages = in_order(imu(stop, 0.0, 16.0, 100.0, rng), fixes(stop, 0.0, 16.0, 10.0, rng, phase_s=0.0137), frozen)
    estimator, outputs = run(machine(lidar=False, more={"wheels": WHEELS}), messages)
    assert kinds(estimator, "wheels") == [EventKind.SENSOR_LOST, EventKind.SENSOR_REGAINED]
    lost, regained = (event for event in estimator.events if event.sensor == "wheels" and event.kind != "rejected")
    assert 6.0 < seconds(lost.stamp_ns) < 8.5 and "innovation" in lost.reason
    assert 11.0 < seconds(regained.stamp_ns) < 13.5
    assert worst_m(stop, outputs, 6.0, 16.0) < FIX_M


def test_silent_wheels_are_lost_and_health_names_it():
    rng = np.random.default_rng(1)
    messages = in_order(
        imu(CURVE, 0.0, 9.0, 100.0, rng),
        fixes(CURVE, 0.0, 9.0, 10.0, rng),
        twists(CURVE, 0.0, 7.0, 10.0, AXLE, 1.0, rng),
    )
    estimator, _ = run(machine(lidar=False, more={"wheels": WHEELS}), messages)
    (event,) = [event for event in estimator.events if event.kind is EventKind.SENSOR_LOST]
    assert (event.sensor, event.reason) == ("wheels", "silent")
    assert 8.0 < seconds(event.stamp_ns) < 8.4
    assert estimator.health is Health.SENSOR_LOST
    assert "wheels" not in estimator.health_report().fused


# --- GNSS velocity ----------------------------------------------------------------------------------------------------


def coarse(drive, sensor=None, end_s=30.0):
    """Fixes of half a metre, 1 Hz, and an IMU of raw MEMS; with what a sensor adds."""
    rng = np.random.default_rng(1)
    return in_order(
        imu(drive, 0.0, end_s, 100.0, rng, densities=(5e-3, 1e-3), bias=(0.05, -0.04, 0.03, 0.005, -0.003, 0.002)),
        fixes(drive, 0.0, end_s, 1.0, rng, (0.5, 0.5, 0.8), phase_s=0.0137),
        sensor or [],
    )


MEMS = {"imu_": {"accelerometer_noise_density": 5e-3, "gyroscope_noise_density": 1e-3}}


def rms_m(drive, outputs, start_s, end_s):
    errors = [deviation(drive, e)[0] for e in estimates(outputs) if ns(start_s) < e.stamp_ns < ns(end_s)]
    return float(np.sqrt(np.mean(np.square(errors))))


def test_a_doppler_velocity_makes_more_of_coarse_fixes():
    curve = replace(CURVE, start_s=6.0)  # fixes of half a metre need five seconds to tell that the machine stands
    doppler = velocities(curve, 0.0, 30.0, rng=np.random.default_rng(2))
    estimator, outputs = run(machine(lidar=False, more={"doppler": DOPPLER}, **MEMS), coarse(curve, doppler))
    assert kinds(estimator, "doppler") == []
    assert estimator.counts["doppler", Outcome.USED] > 100
    _, alone = run(machine(lidar=False, **MEMS), coarse(curve))
    assert rms_m(curve, outputs, 10.0, 30.0) < 0.6 * rms_m(curve, alone, 10.0, 30.0)


def test_a_vertical_velocity_that_nobody_measured_is_left_out():
    """NMEA drivers write zero; here 2 m/s up are so far from it that the sensor would be lost."""
    climb = Drive(tilt=0.0, heave_m=3.0)
    rng = np.random.default_rng(2)
    flat = [replace(m, velocity=m.velocity * [1.0, 1.0, 0.0], covariance=None) for m in velocities(climb, 0.0, 9.0)]
    messages = in_order(imu(climb, 0.0, 9.0, 100.0, rng), fixes(climb, 0.0, 9.0, 10.0, rng, phase_s=0.0137), flat)
    for axes, lost in ((("x", "y"), []), (("x", "y", "z"), [EventKind.SENSOR_LOST])):
        estimator, outputs = run(machine(lidar=False, more={"doppler": DOPPLER | {"axes": axes}}), messages)
        assert kinds(estimator, "doppler")[:1] == lost
        assert worst_m(climb, outputs, 3.0, 9.0) < FIX_M


def test_a_frozen_velocity_is_lost_by_name_harms_nothing_and_is_regained():
    rng = np.random.default_rng(1)
    doppler = velocities(CURVE, 0.0, 20.0, rng=rng)
    stuck = next(m for m in doppler if m.stamp_ns > ns(8.0))
    frozen = [replace(m, velocity=stuck.velocity) if ns(8.0) < m.stamp_ns < ns(11.0) else m for m in doppler]
    messages = in_order(imu(CURVE, 0.0, 20.0, 100.0, rng), fixes(CURVE, 0.0, 20.0, 10.0, rng, phase_s=0.0137), frozen)
    estimator, outputs = run(machine(lidar=False, more={"doppler": DOPPLER}), messages)
    assert kinds(estimator, "doppler") == [EventKind.SENSOR_LOST, EventKind.SENSOR_REGAINED]
    assert not kinds(estimator, "gnss")
    assert worst_m(CURVE, outputs, 8.0, 20.0) < FIX_M


# --- nonholonomic -----------------------------------------------------------------------------------------------------


def test_a_mounting_that_is_off_by_half_a_degree_is_found():
    """The configuration has the frame turned by 0.5 deg against the direction in which the machine drives."""
    off = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.0, np.radians(0.5), np.radians(-0.5)), np.zeros(3))
    no_slip = {
        "kind": "nonholonomic",
        "topic": None,
        "mount": off,
        "slip_ratio": 0.0,
        "sigma_m_s": 0.02,
        "correlation_s": 0.0,
    }
    rng = np.random.default_rng(1)
    antennas = [
        fixes(ROAD, 0.0, 20.0, 10.0, rng, phase_s=0.0137, arm=arm, sensor=name)
        for name, arm in (("gnss", ARM), ("gnss_right", ARM_RIGHT))
    ]
    messages = in_order(imu(ROAD, 0.0, 20.0, 100.0, rng), *antennas)
    optimiser, log, _ = optimised(machine(lidar=False, right=True, more={"rear": no_slip}), messages)
    found, sigmas = np.degrees(optimiser.tracking.graph.main.parameters.estimate("rear"))
    assert (abs(found - [0.5, -0.5]) < 4.0 * sigmas).all() and (sigmas < 0.06).all()
    assert kinds(log, "rear") == []


def test_a_machine_that_does_not_slip_drifts_less_in_an_outage():
    no_slip = {"kind": "nonholonomic", "topic": None, "mount": at([0.0, 0.0, 0.0]), "mounting_sigma_deg": 0.2}
    rng = np.random.default_rng(1)
    bias = (0.03, -0.05, 0.02, 0.0, 0.0, 0.0)
    messages = in_order(
        imu(ROAD, 0.0, 30.0, 100.0, rng, bias=bias),
        silent(fixes(ROAD, 0.0, 30.0, 10.0, rng, phase_s=0.0137), 12.0, 28.0),
    )
    errors = {}
    for more in ({}, {"rear": no_slip}):
        estimator, outputs = run(machine(lidar=False, more=more), messages)
        errors[len(more)] = worst_m(ROAD, outputs, 12.0, 28.0)
        assert not [event for event in estimator.events if event.sensor == "rear"]
    assert errors[1] < 0.5 * errors[0]
    assert errors[1] < 0.03 * 48.0


# --- prism ------------------------------------------------------------------------------------------------------------


def test_a_prism_does_what_gnss_does():
    rng = np.random.default_rng(1)
    messages = in_order(imu(CURVE, 0.0, 12.0, 100.0, rng), prisms(CURVE, 0.0, 12.0, 10.0, rng=rng))
    estimator, outputs = run(machine(gnss=False, lidar=False, more={"prism": PRISM}), messages)
    assert estimator.counts["prism", Outcome.USED] > 100
    assert worst_m(CURVE, outputs, 7.0, 12.0) < 5.0 * 0.005


def test_a_prism_that_is_silent_and_comes_back_is_an_outage():
    rng = np.random.default_rng(1)
    messages = in_order(
        imu(CURVE, 0.0, 16.0, 100.0, rng),
        silent(prisms(CURVE, 0.0, 16.0, 10.0, rng=rng), 8.0, 12.0),
        scans(CURVE, 0.0, 16.0, 5.0, rng),
    )
    estimator, outputs = run(machine(gnss=False, more={"prism": PRISM}), messages)
    assert kinds(estimator, "prism") == [EventKind.RECEIVER_LOST, EventKind.RECEIVER_REGAINED]
    assert kinds(estimator, "").count(EventKind.GNSS_LOST) == kinds(estimator, "").count(EventKind.GNSS_REGAINED) == 1
    assert worst_m(CURVE, outputs, 8.0, 12.0) < 0.3
    assert worst_m(CURVE, outputs, 13.0, 16.0) < 5.0 * 0.005


def test_a_prism_that_swaps_its_target_is_lost_by_name_and_harms_nothing():
    """From 8 to 12 s the station follows a prism that stands 4 m aside."""
    rng = np.random.default_rng(1)
    wrong = prisms(Drive(start_s=100.0), 0.0, 16.0, 10.0, arm=np.array([3.0, -3.0, 1.0]), rng=rng)
    right = prisms(CURVE, 0.0, 16.0, 10.0, rng=rng)
    swapped = [w if ns(8.0) < w.stamp_ns < ns(12.0) else r for w, r in zip(wrong, right, strict=True)]
    messages = in_order(imu(CURVE, 0.0, 16.0, 100.0, rng), swapped, scans(CURVE, 0.0, 16.0, 5.0, rng))
    estimator, outputs = run(machine(gnss=False, more={"prism": PRISM}), messages)
    assert kinds(estimator, "prism") == [EventKind.RECEIVER_LOST, EventKind.RECEIVER_REGAINED]
    (lost,) = [event for event in estimator.events if event.kind is EventKind.RECEIVER_LOST]
    assert 8.0 < seconds(lost.stamp_ns) < 9.0
    assert worst_m(CURVE, outputs, 8.0, 12.0) < 0.3
    assert worst_m(CURVE, outputs, 15.0, 16.0) < FIX_M


# --- pose -------------------------------------------------------------------------------------------------------------


def test_poses_alone_start_the_estimator_and_hold_it():
    rng = np.random.default_rng(1)
    messages = in_order(imu(CURVE, 0.0, 14.0, 100.0, rng), poses(CURVE, 0.0, 14.0, rng=rng))
    config = machine(gnss=False, lidar=False, heading_deg=None, more={"marker": MARKER})
    estimator, outputs = run(config, messages)
    assert estimator.initialised
    assert worst_m(CURVE, outputs, 8.0, 14.0) < 3.0 * 0.05
    assert max(deviation(CURVE, e)[1] for e in estimates(outputs) if e.stamp_ns > ns(8.0)) < np.radians(1.5)


@pytest.mark.parametrize("yaw_deg", [3.0, 40.0])
def test_a_frame_that_is_offset_from_w_is_found_and_carries_an_outage(yaw_deg):
    T_W_F = gtsam.Pose3(gtsam.Rot3.Yaw(np.radians(yaw_deg)), np.array([20.0, -10.0, 2.0]))
    marker = MARKER | {"offset_sigma_m": 50.0, "offset_sigma_deg": 45.0}
    rng = np.random.default_rng(1)
    messages = in_order(
        imu(CURVE, 0.0, 30.0, 100.0, rng),
        silent(fixes(CURVE, 0.0, 30.0, 10.0, rng, phase_s=0.0137), 14.0, 28.0),
        poses(CURVE, 0.0, 30.0, T_W_F=T_W_F, rng=rng),
    )
    config = machine(lidar=False, more={"marker": marker})
    optimiser, log, _ = optimised(config, messages)
    found, sigmas = optimiser.tracking.graph.main.parameters.estimate("marker")
    assert (abs(found - [20.0, -10.0, 2.0, np.radians(yaw_deg)]) < 4.0 * sigmas).all() and (sigmas < 0.06).all()
    assert kinds(log, "marker") == []
    _, outputs = run(config, messages)
    assert worst_m(CURVE, outputs, 8.0, 14.0) < FIX_M
    assert worst_m(CURVE, outputs, 14.0, 28.0) < 0.25
    # the recovery finds what was known before, to a hundredth of a degree
    assert deviation(CURVE, estimates(outputs)[-1])[1] < np.radians(0.6)


def test_an_offset_of_a_hundred_metres_is_found_although_the_machine_starts_six_degrees_off():
    """What the first poses say of the frame is wrong by as much, and is linearised anew as the heading is found."""
    T_W_F = gtsam.Pose3(gtsam.Rot3.Yaw(np.radians(40.0)), np.array([100.0, -60.0, 2.0]))
    marker = MARKER | {"offset_sigma_m": 200.0, "offset_sigma_deg": 45.0}
    rng = np.random.default_rng(1)
    messages = in_order(
        imu(CURVE, 0.0, 12.0, 100.0, rng),
        fixes(CURVE, 0.0, 12.0, 10.0, rng, phase_s=0.0137),
        poses(CURVE, 0.0, 12.0, T_W_F=T_W_F, rng=rng),
    )
    start = {"heading_deg": HEADING_DEG + 6.0, "initialisation": {"heading_sigma_deg": 6.0}}
    optimiser, _, _ = optimised(machine(lidar=False, more={"marker": marker}, **start), messages)
    found, sigmas = optimiser.tracking.graph.main.parameters.estimate("marker")
    assert (abs(found - [100.0, -60.0, 2.0, np.radians(40.0)]) < 3.0 * sigmas).all() and (sigmas < 0.3).all()


def test_poses_that_are_a_metre_off_beside_good_gnss_are_lost_by_name_and_harm_nothing():
    rng = np.random.default_rng(1)
    off = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.0, 0.0]))
    messages = in_order(
        imu(CURVE, 0.0, 12.0, 100.0, rng),
        fixes(CURVE, 0.0, 12.0, 10.0, rng, phase_s=0.0137),
        poses(CURVE, 2.0, 12.0, T_W_F=off, rng=rng),
    )
    estimator, outputs = run(machine(lidar=False, more={"marker": MARKER}), messages)
    assert kinds(estimator, "marker") == [EventKind.SENSOR_LOST]
    assert estimator.counts["marker", Outcome.USED] == 0
    assert not kinds(estimator, "gnss")
    assert worst_m(CURVE, outputs, 6.0, 12.0) < FIX_M
    assert estimator.health is Health.SENSOR_LOST


# --- height -----------------------------------------------------------------------------------------------------------


def test_a_height_with_an_unknown_constant_learns_it_from_gnss_and_holds_the_height_without():
    laser = LASER | {"offset_sigma_m": 100.0, "sigma_m": 0.02}
    rng = np.random.default_rng(1)
    bias = (0.0, 0.0, 0.05, 0.0, 0.0, 0.0)
    messages = in_order(
        imu(CURVE, 0.0, 30.0, 100.0, rng, bias=bias),
        silent(fixes(CURVE, 0.0, 30.0, 10.0, rng, phase_s=0.0137), 14.0, 28.0),
        heights(CURVE, 0.0, 30.0, 5.0, ARM, 37.0, rng, 0.02),
        scans(CURVE, 0.0, 30.0, 5.0, rng),
    )
    config = machine(more={"laser": laser})
    optimiser, log, _ = optimised(config, messages)
    (constant,), _ = optimiser.tracking.graph.main.parameters.estimate("laser")
    assert constant == pytest.approx(37.0, abs=0.03)
    assert kinds(log, "laser") == []
    _, outputs = run(config, messages)
    inside = [e for e in estimates(outputs) if ns(14.0) < e.stamp_ns < ns(28.0)]
    up_m = [e.nav.position()[2] - CURVE.nav(seconds(e.stamp_ns)).position()[2] for e in inside]
    assert abs(np.array(up_m)).max() < 0.08


# --- odometries -------------------------------------------------------------------------------------------------------


def test_of_two_odometries_one_that_jumps_and_dies_costs_nothing():
    """The camera jumps at 9 s and 10 s, and is silent from 12 s on; GNSS is away from 8 to 18 s."""
    rng = np.random.default_rng(1)
    samples = imu(CURVE, 0.0, 20.0, 100.0, rng)
    antenna = silent(fixes(CURVE, 0.0, 20.0, 10.0, rng, phase_s=0.0137), 8.0, 18.0)
    lidar = scans(CURVE, 0.0, 20.0, 5.0, rng, phase_s=0.0071)
    camera = scans(CURVE, 0.0, 20.0, 5.0, rng, phase_s=0.0871, sensor="camera")
    for k, message in enumerate(camera):
        jumps = (message.stamp_ns > ns(9.0)) + (message.stamp_ns > ns(10.0))
        camera[k] = replace(message, position=message.position + jumps * np.array([2.0, -1.0, 0.5]))
    camera = [m for m in camera if m.stamp_ns < ns(12.0)]
    mount = machine().T_I("lidar")
    more = {"camera": {"kind": "odometry", "mount": gtsam.Pose3(mount)}}
    _, alone = run(machine(), in_order(samples, antenna, lidar))
    estimator, both = run(machine(more=more), in_order(samples, antenna, lidar, camera))
    assert worst_m(CURVE, both, 8.0, 20.0) < 1.1 * worst_m(CURVE, alone, 8.0, 20.0) + 0.02
    assert kinds(estimator, "camera") == [EventKind.ODOMETRY_JUMP, EventKind.ODOMETRY_JUMP, EventKind.SENSOR_LOST]
    assert not kinds(estimator, "lidar")
    assert estimator.health is Health.ODOMETRY_LOST or estimator.health is Health.RECOVERING


def test_the_names_of_the_sensors_do_not_matter():
    rng = np.random.default_rng(1)
    names = {"imu": "imu", "gnss": "mast", "lidar": "front_laser"}
    messages = in_order(
        imu(CURVE, 0.0, 7.0, 100.0, rng), fixes(CURVE, 0.0, 7.0, 10.0, rng), scans(CURVE, 0.0, 7.0, 5.0, rng)
    )
    config = machine()
    renamed_sections = config.model_dump(exclude_unset=True)
    renamed_sections["sensors"] = {
        names[name]: {**section, "frame": name} for name, section in renamed_sections["sensors"].items()
    }
    renamed = type(config).model_validate(renamed_sections)
    _, plain = run(config, messages)
    _, other = run(renamed, [replace(m, sensor=names[m.sensor]) for m in messages])
    assert len(estimates(plain)) > 400
    for one, two in zip(estimates(plain), estimates(other), strict=True):
        assert (one.nav.matrix() == two.nav.matrix()).all()
