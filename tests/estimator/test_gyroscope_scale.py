"""The scale factors of the gyroscope are found while GNSS is there, and carry the heading where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from motion import ARM_RIGHT, Drive, estimates, fixes, imu, in_order, machine, optimised, run, seconds

from holdfast.calibration.learnt_table import learnt_rows
from holdfast.events import EventKind
from holdfast.integrity.learnt_snapshot import LearntSnapshot

DRIVE = Drive(radius_m=4.0, speed=0.5)  # it turns by 0.5 rad/s
END_S, LOST_S = 60.0, 40.0
RATIO = 0.003  # of the file
SCALE = np.array([0.002, -0.003, 0.006])
BIAS = np.array([0.02, -0.02, 0.01, 0.002, -0.001, 0.003])


def messages(scale=SCALE, end_s=END_S, lost_s=LOST_S, seed=1):
    """Two antennas until GNSS is lost, an IMU whose gyroscope measures too much."""
    rng = np.random.default_rng(seed)
    samples = [
        replace(one, angular_velocity=BIAS[3:] + (1.0 + scale) * (one.angular_velocity - BIAS[3:]))
        for one in imu(DRIVE, 0.0, end_s, 100.0, rng, bias=BIAS)
    ]
    sigma = (0.003, 0.003, 0.006)
    left = fixes(DRIVE, 0.0, lost_s, 10.0, rng, sigma)
    right = fixes(DRIVE, 0.0, lost_s, 10.0, rng, sigma, arm=ARM_RIGHT, sensor="gnss_right")
    return in_order(samples, left, right)


def configured(ratio=RATIO, *, estimated=True):
    return machine(lidar=False, right=True, imu_={"gyroscope_error_ratio": ratio}, graph={"gyroscope_scale": estimated})


def heading_error(outputs):
    """Root mean square after GNSS is lost [deg]."""
    late = [one for one in estimates(outputs) if seconds(one.stamp_ns) > LOST_S]
    yaw = [float((DRIVE.nav(seconds(one.stamp_ns)).attitude().inverse() * one.nav.attitude()).rpy()[2]) for one in late]
    return np.degrees(np.sqrt(np.mean(np.square(yaw))))


@pytest.fixture(scope="module")
def known():
    """The optimiser at the loss of GNSS."""
    return optimised(configured(), messages(end_s=LOST_S))[0]


def test_scale_factors_are_found_within_their_sigmas(known):
    constant = known.constants()["imu"]
    assert (np.abs(constant.value - SCALE) < 3.5 * constant.sigmas).all()
    assert constant.sigmas[2] < 0.3 * RATIO  # it turns about the vertical most


def test_the_published_bias_is_without_them(known):
    newest = known.tracking.graph.published.newest
    sigmas = np.sqrt(np.diag(newest.covariance)[12:])
    assert (np.abs(newest.bias.gyroscope() - BIAS[3:]) < 4.0 * sigmas).all() and sigmas.max() < 5e-4


def test_they_hold_the_heading_where_nothing_else_does():
    """0.006 of 10 rad would be 3.4 deg."""
    _, found = run(configured(), messages())
    _, believed = run(configured(estimated=False), messages())
    assert heading_error(found) < 0.5 * heading_error(believed)


def test_one_that_is_far_off_is_told_once():
    _, log, _ = optimised(configured(0.01), messages(np.array([0.0, 0.0, 0.02]), end_s=LOST_S))
    (told,) = [event for event in log.take_events() if event.kind is EventKind.CALIBRATION and event.sensor == "imu"]
    words = told.reason.split()
    assert told.reason.startswith("its gyroscope shows") and "more about z than it turns" in told.reason
    assert float(words[3]) == pytest.approx(2.0, abs=0.3)


def test_the_report_shows_what_the_machine_has_turned_about(known):
    rows = [row for row in learnt_rows(known.learnt(), configured()) if row.what.startswith("scale factor of")]
    assert "scale factor of the gyroscope, z" in [row.what for row in rows]
    (about_z,) = [row for row in rows if row.what.endswith("z")]
    assert about_z.learnt == pytest.approx(1.0 + SCALE[2], abs=4.0 * about_z.sigma)


def test_right_scale_factors_lose_nothing():
    nothing = np.zeros(3)
    _, found = run(configured(), messages(nothing))
    _, believed = run(configured(estimated=False), messages(nothing))
    assert heading_error(found) < heading_error(believed) + 0.1


def test_a_gyroscope_that_the_file_calls_perfect_has_none():
    assert "imu" not in optimised(configured(0.0), messages(end_s=5.0))[0].constants()


def test_they_are_kept_for_the_next_day(known):
    kept = LearntSnapshot.model_validate_json(known.learnt().model_dump_json())
    assert kept.constants["imu"].mean == pytest.approx(known.constants()["imu"].value)
    estimator, _ = run(configured(), messages(end_s=4.0), kept)
    constant = estimator.constants()["imu"]
    assert (np.abs(constant.value - SCALE)[2] < 0.2 * SCALE[2]) and constant.sigmas[2] < 0.6 * RATIO
