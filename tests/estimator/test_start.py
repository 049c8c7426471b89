"""Coming up: at standstill and in motion, with every source of heading; and what is refused, with its reason."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import (
    ARM,
    ARM_RIGHT,
    UP,
    Drive,
    apart,
    deviation,
    estimates,
    fixes,
    imu,
    in_order,
    machine,
    ns,
    run,
    scans,
    seconds,
)

from holdfast.estimator.first_heading import Told, believed
from holdfast.events import EventKind, Outcome
from holdfast.messages import Heading

STANDING = Drive(start_s=100.0)
TRUTH = STANDING.nav(0.0)


def standing(seed=1, bias=None, end_s=3.0, densities=(2e-3, 2e-4)):
    return imu(STANDING, 0.0, end_s, 100.0, np.random.default_rng(seed), densities, bias)


def first_state(outputs):
    return next(o.optimised for o in outputs if o.optimised is not None)


def yaw_of(nav):
    return nav.attitude().rpy()[2]


def without_heading(**sections):
    return machine(initialisation={"heading_deg": None}, **sections)


# --- at standstill ----------------------------------------------------------------------------------------------------


def test_gravity_gives_roll_and_pitch_the_configuration_heading_and_the_lever_arm_position():
    _, outputs = run(machine(), in_order(standing(), fixes(STANDING, 0.0, 3.0, rng=np.random.default_rng(2))))
    state = first_state(outputs)
    position, rotation, velocity = apart(TRUTH, state.nav)
    # 11 fixes in the second that is averaged; 100 samples of 0.02 m/s^2 against gravity
    assert position < 5.0 * np.linalg.norm([0.01, 0.01, 0.02]) / np.sqrt(10.0)
    assert rotation < 5.0 * 0.02 / np.sqrt(100.0) / 9.8
    assert velocity == 0.0


def test_the_bias_of_the_gyroscope_is_found_within_its_noise():
    bias = [0.0, 0.0, 0.0, 0.004, -0.003, 0.002]
    for seed in range(5):
        _, outputs = run(machine(), in_order(standing(seed, bias), fixes(STANDING, 0.0, 3.0)))
        assert abs(first_state(outputs).bias.gyroscope() - bias[3:]).max() < 4.0 * 2e-4 / np.sqrt(1.0)


def test_the_bias_of_the_accelerometer_is_found_along_gravity():
    R = TRUTH.attitude()
    along = R.unrotate(np.array([0.0, 0.0, 0.07]))
    _, outputs = run(machine(), in_order(standing(1, [*along, 0, 0, 0]), fixes(STANDING, 0.0, 3.0)))
    found = first_state(outputs).bias.accelerometer()
    assert np.linalg.norm(found - along) < 4.0 * 0.02 / np.sqrt(100.0)


def test_an_engine_that_shakes_the_standing_machine_by_a_metre_per_second_squared_does_not_keep_it_from_starting():
    shaken = [
        replace(m, specific_force=m.specific_force + np.sin(2.0 * np.pi * 28.0 * seconds(m.stamp_ns)) * np.ones(3))
        for m in standing()
    ]
    _, outputs = run(machine(), in_order(shaken, fixes(STANDING, 0.0, 3.0, rng=np.random.default_rng(2))))
    state = first_state(outputs)
    assert seconds(state.stamp_ns) < 1.5
    assert apart(TRUTH, state.nav)[1] < 5.0 * 0.02 / np.sqrt(100.0) / 9.8 + 0.01 / 9.8  # 28 periods leave 1 % at most


def test_two_antennas_of_a_standing_machine_are_no_motion():
    config = without_heading(right=True, standstill={"max_acceleration": 1e-4})  # never quiet
    estimator, _ = run(
        config,
        in_order(standing(), fixes(STANDING, 0.0, 3.0), fixes(STANDING, 0.0, 3.0, arm=ARM_RIGHT, sensor="gnss_right")),
    )
    assert "moved 0.0 m" in estimator.waiting_for


def test_a_heading_message_goes_before_the_configuration():
    axis = TRUTH.attitude().rotate(np.array([np.cos(np.radians(30.0)), np.sin(np.radians(30.0)), 0.0]))
    message = Heading(ns(0.5), ns(0.5), "heading", np.arctan2(axis[1], axis[0]), 0.01)
    config = machine(heading=True, heading_={"mounting_yaw_deg": 30.0}, heading_deg=170.0)
    _, outputs = run(config, in_order(standing(), fixes(STANDING, 0.0, 3.0), [message]))
    assert yaw_of(first_state(outputs).nav) == pytest.approx(0.3, abs=1e-3)  # roll and pitch are from the IMU


@pytest.mark.parametrize("yaw_rad", [-3.0, -1.2, 0.0, 2.5])
def test_two_antennas_give_the_heading_though_they_are_not_mounted_square(yaw_rad):
    still = Drive(start_s=100.0, yaw_rad=yaw_rad)
    rng = np.random.default_rng(4)
    left = fixes(still, 0.0, 3.0, rng=rng)
    right = fixes(still, 0.0, 3.0, rng=rng, arm=ARM_RIGHT, sensor="gnss_right")
    samples = imu(still, 0.0, 3.0, 100.0, np.random.default_rng(5))
    _, outputs = run(without_heading(right=True), in_order(samples, left, right))
    state = first_state(outputs)
    length = np.linalg.norm((ARM_RIGHT - ARM)[:2])
    off = np.arctan2(np.sin(yaw_of(state.nav) - yaw_rad), np.cos(yaw_of(state.nav) - yaw_rad))
    assert abs(off) < 4.0 * 0.01 * np.sqrt(2.0) / length / np.sqrt(10.0)
    sigma = np.sqrt((state.nav.attitude().matrix() @ state.covariance[:3, :3] @ state.nav.attitude().matrix().T)[2, 2])
    assert 0.2 * 0.01 / length < sigma < 3.0 * 0.01 / length


@pytest.mark.parametrize(
    ("told", "found"),
    [
        ({"compass": Told(1.0, 0.1)}, (1.0, 0.1)),
        ({"compass": Told(1.0, 0.1), "antennas": Told(1.1, 0.01)}, (1.1, 0.01)),  # the surer
        ({"compass": Told(3.1, 0.01), "antennas": Told(-3.1, 0.02)}, (3.1, 0.01)),  # across the south
        ({"compass": Told(-2.0, 0.001), "antennas": Told(1.1, 0.02), "markers": Told(1.1, 0.01)}, (1.1, 0.01)),
        ({"compass": Told(1.0, 0.03, 0.04)}, (1.0, 0.05)),  # whose mounting is doubted
        ({"compass": Told(1.0, 0.001, 0.2), "antennas": Told(1.1, 0.02)}, (1.1, 0.02)),
    ],
)
def test_of_those_who_tell_a_first_heading_most_are_believed(told, found):
    assert believed(told) == found


@pytest.mark.parametrize("off_deg", [5.0, 180.0])
def test_a_heading_beside_which_two_antennas_say_another_waits_for_the_motion(off_deg):
    """A machine that stood began the wrong way round, and was 22 m off before it was believed."""
    off_rad = np.radians(off_deg)
    heading = Heading(ns(0.5), ns(0.5), "heading", STANDING.yaw_rad + off_rad, np.radians(1.0))
    streams = [standing(), fixes(STANDING, 0.0, 3.0), fixes(STANDING, 0.0, 3.0, sensor="gnss_right", arm=ARM_RIGHT)]
    config = without_heading(right=True, heading=True, heading_={"mounting_yaw_deg": 0.0})
    estimator, _ = run(config, in_order(*streams, [heading]))
    assert estimator.initialised == (off_deg == 5.0)
    apart = "the headings of heading and of gnss to gnss_right are 180 deg apart: which is right, motion tells"
    assert estimator.waiting_for == ("" if estimator.initialised else apart)


def test_antennas_at_another_distance_than_in_the_extrinsics_are_refused_with_both_lengths():
    rng = np.random.default_rng(4)
    left = fixes(STANDING, 0.0, 3.0, rng=rng)
    right = fixes(STANDING, 0.0, 3.0, rng=rng, arm=ARM + 1.5 * (ARM_RIGHT - ARM), sensor="gnss_right")
    estimator, _ = run(without_heading(right=True), in_order(standing(), left, right))
    assert not estimator.initialised
    length = np.linalg.norm(ARM_RIGHT - ARM)
    reasons = [event.reason for event in estimator.events] + [estimator.waiting_for]
    expected = f"the antennas are {1.5 * length:.2f} m apart, the extrinsics say {length:.2f} m"
    assert any(expected[:20] in reason and expected[-28:] in reason for reason in reasons)


def test_standing_still_without_a_heading_asks_for_one():
    estimator, _ = run(without_heading(), in_order(standing(), fixes(STANDING, 0.0, 3.0)))
    assert not estimator.initialised
    assert estimator.waiting_for.startswith("standing still without a heading")
    assert estimator.counts["gnss", Outcome.BEFORE_START] == 31


def test_without_gnss_the_world_begins_where_the_machine_stands():
    _, outputs = run(without_heading(gnss=False), in_order(standing(), scans(STANDING, 0.0, 3.0)))
    state = first_state(outputs)
    assert np.linalg.norm(state.nav.position()) < 1e-9 and abs(yaw_of(state.nav)) < 1e-9


def test_an_accelerometer_in_g_is_refused_with_the_hint():
    samples = [replace(s, specific_force=s.specific_force / 9.80665) for s in standing()]
    estimator, _ = run(machine(), in_order(samples, fixes(STANDING, 0.0, 3.0)))
    assert not estimator.initialised
    assert "mean specific force is 1.00 m/s^2" in estimator.waiting_for
    assert "is the accelerometer in g?" in estimator.waiting_for


@pytest.mark.parametrize("gnss_hz", [1.0, 10.0])
def test_an_even_drive_is_as_quiet_as_standstill_but_gnss_tells_them_apart(gnss_hz):
    """1.5 m/s straight ahead, from the first sample on."""
    even = gtsam.ConstantTwistScenario(np.zeros(3), np.array([1.5, 0.0, 0.0]), gtsam.Pose3())

    class Even:
        def nav(self, t):
            return even.navState(t)

        def pose(self, t):
            return even.pose(t)

        def readings(self, _):
            return UP, np.zeros(3)

    samples = imu(Even(), 0.0, 6.0, 100.0, np.random.default_rng(1))
    estimator, outputs = run(machine(heading_deg=0.0), in_order(samples, fixes(Even(), 0.0, 6.0, gnss_hz)))
    standing_claims = [e for e in estimator.events if e.kind is EventKind.INITIALISED and e.reason == "standstill"]
    assert not standing_claims
    if estimator.initialised:
        assert np.linalg.norm(first_state(outputs).nav.velocity() - [1.5, 0.0, 0.0]) < 0.1


@pytest.mark.parametrize("sigma_m", [0.5, 0.8])
def test_a_standing_machine_whose_heading_is_configured_starts_with_coarse_fixes_of_1_hz(sigma_m):
    """Five seconds of 0.8 m tell the speed to 0.36 m/s at best: more seconds tell it better."""
    rng, sigma = np.random.default_rng(1), (sigma_m, sigma_m, 2.0 * sigma_m)
    messages = in_order(
        imu(STANDING, 0.0, 25.0, 50.0, rng), fixes(STANDING, 0.0, 24.0, 1.0, rng, sigma, phase_s=0.0137)
    )
    estimator, _ = run(machine(lidar=False), messages)
    assert estimator.initialised, estimator.waiting_for


def test_nothing_comes_up_before_the_imu_has_measured_for_the_whole_standstill():
    _, outputs = run(machine(), in_order(standing(), fixes(STANDING, 0.0, 3.0)))
    assert 1.0 <= seconds(first_state(outputs).stamp_ns) <= 1.2


# --- in motion --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lidar", [False, True])
@pytest.mark.parametrize("yaw_rad", [0.3, 2.8])
def test_in_motion_gnss_and_imu_give_all_with_or_without_the_lidars_track(lidar, yaw_rad):
    drive = Drive(start_s=-4.0, yaw_rad=yaw_rad)
    rng = np.random.default_rng(6)
    streams = [imu(drive, 0.0, 12.0, 100.0, rng), fixes(drive, 0.0, 12.0, rng=rng, phase_s=0.013)]
    if lidar:
        streams.append(scans(drive, 0.0, 12.0, rng=rng, phase_s=0.007))
    estimator, outputs = run(without_heading(lidar=lidar), in_order(*streams))
    assert estimator.initialised
    state = first_state(outputs)
    assert seconds(state.stamp_ns) < 8.0
    step = state.nav.localCoordinates(drive.nav(seconds(state.stamp_ns)))
    assert (abs(step) < 4.0 * np.sqrt(np.diag(state.covariance)[:9]) + 1e-3).all()
    position, rotation, velocity = deviation(drive, estimates(outputs)[-1])
    assert position < 0.05 and rotation < np.radians(2.0) and velocity < 0.1


def test_in_motion_the_clock_of_the_receiver_may_be_off():
    """The state is that of another time, and says so: else the start itself would testify that the clock is right."""
    drive, rng = Drive(start_s=-4.0, yaw_rad=0.3), np.random.default_rng(6)
    early = [
        replace(fix, stamp_ns=fix.stamp_ns - 40_000_000) for fix in fixes(drive, 0.0, 12.0, rng=rng, phase_s=0.013)
    ]
    _, outputs = run(without_heading(lidar=False), in_order(imu(drive, 0.0, 12.0, 100.0, rng), early))
    state = first_state(outputs)
    step = state.nav.localCoordinates(drive.nav(seconds(state.stamp_ns)))[:6]
    assert step @ np.linalg.solve(state.covariance[:6, :6], step) < 22.46  # chi-square of six, 99.9 %


@pytest.mark.parametrize("off_m", [3.0, 30.0])
@pytest.mark.parametrize("right", [False, True])
def test_in_motion_a_fix_that_is_elsewhere_does_not_keep_it_from_starting(off_m, right):
    """The second of all, by a receiver of 1 Hz, kept it waiting for 17 to 31 s, or for good."""
    road, rng = Drive(start_s=-6.0, ramp_s=4.0, radius_m=8.0, speed=0.2), np.random.default_rng(4)
    left = fixes(road, 0.0, 12.0, 1.0, rng, phase_s=0.0137)
    left[1] = replace(left[1], latitude_deg=left[1].latitude_deg + off_m * 9e-6)
    streams = [imu(road, 0.0, 12.0, 50.0, rng), left, scans(road, 0.0, 12.0, 5.0, rng, (0.001, 0.01))]
    if right:
        streams.append(fixes(road, 0.0, 12.0, 1.0, rng, phase_s=0.0137, sensor="gnss_right", arm=ARM_RIGHT))
    _, outputs = run(without_heading(right=right), in_order(*streams))
    assert seconds(first_state(outputs).stamp_ns) < 6.0
    off = [deviation(road, one)[0] for one in estimates(outputs) if one.stamp_ns > ns(9.0)]
    assert np.sqrt(np.mean(np.square(off))) < 0.1


def test_a_straight_slow_creep_is_too_short_for_a_heading():
    """Less than two metres: the motion is known, no heading is guessed."""

    class Creep:
        def nav(self, t):
            return gtsam.NavState(gtsam.Rot3(), np.array([0.3 * t, 0.0, 0.0]), np.array([0.3, 0.0, 0.0]))

        def pose(self, t):
            return self.nav(t).pose()

        def readings(self, _):
            return UP, np.zeros(3)

    rng = np.random.default_rng(3)
    messages = in_order(imu(Creep(), 0.0, 6.0, 100.0, rng), fixes(Creep(), 0.0, 6.0, rng=rng))
    estimator, outputs = run(without_heading(lidar=False), messages)
    assert not estimator.initialised and not estimates(outputs)
    assert "a heading from motion needs 2.0 m" in estimator.waiting_for


@pytest.mark.slow
def test_an_even_straight_drive_fits_every_heading_and_is_refused():
    """Ten metres without any acceleration: the accelerometer does not observe where the machine points."""

    class Even:
        def nav(self, t):
            return gtsam.NavState(gtsam.Rot3(), np.array([1.0 * t, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))

        def pose(self, t):
            return self.nav(t).pose()

        def readings(self, _):
            return UP, np.zeros(3)

    rng = np.random.default_rng(3)
    messages = in_order(imu(Even(), 0.0, 10.0, 100.0, rng), fixes(Even(), 0.0, 10.0, rng=rng))
    estimator, _ = run(without_heading(lidar=False), messages)
    assert not estimator.initialised
    assert "heading" in estimator.waiting_for


def test_moving_without_gnss_asks_for_a_start_at_standstill():
    drive = Drive(start_s=-4.0)
    streams = in_order(imu(drive, 0.0, 4.0, 100.0, np.random.default_rng(1)), scans(drive, 0.0, 4.0))
    estimator, _ = run(without_heading(gnss=False), streams)
    assert estimator.waiting_for == "moving, and no source of positions is configured: start at standstill"


@pytest.mark.parametrize("sigma_rad", [np.nan, np.inf, 1e300])
def test_a_heading_with_an_absurd_sigma_does_not_spoil_the_start(sigma_rad):
    message = Heading(ns(0.5), ns(0.5), "heading", 0.3, sigma_rad)
    drive = Drive()
    rng = np.random.default_rng(1)
    messages = in_order(imu(drive, 0.0, 9.0, 100.0, rng), fixes(drive, 0.0, 9.0, rng=rng), [message])
    _, outputs = run(machine(heading=True, lidar=False), messages)
    assert all(np.isfinite(e.covariance).all() for e in estimates(outputs))
    assert deviation(drive, estimates(outputs)[-1])[0] < 0.05
