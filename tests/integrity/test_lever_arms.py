"""Antennas that are not as far apart as mounted: an arm is wrong, and it is said which may be; noise never says so."""

import re

import gtsam
import numpy as np
import pytest
from motion import ARM, ARM_RIGHT, Drive, at, machine, ns
from rig import truth

from holdfast.event_log import EventLog
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.integrity.lever_arms import LeverArms, variance_along
from holdfast.messages import Heading
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import Position, State

BASELINE = ARM_RIGHT - ARM
ACROSS = np.cross(BASELINE, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(BASELINE, [0.0, 0.0, 1.0]))
ALONG = BASELINE / np.linalg.norm(BASELINE)
RTK, FLOAT, LOW = (0.01, 0.01, 0.02), (0.3, 0.3, 0.5), (0.01, 0.01, 0.5)
ARMS = {"gnss": ARM, "gnss_right": ARM_RIGHT}
CONFIG = machine(right=True, heading=True)
SENSORS = sensors_of(CONFIG)


class Run:
    """Fixes of a machine that turns at 0.3 rad/s, its antennas off from their lever arms by so much."""

    def __init__(self, sensors=SENSORS, arms=ARMS, hz=10.0, seed=0):
        self.arms, self.truth, self.hz = LeverArms(sensors), arms, hz
        self.rng, self.log, self.t = np.random.default_rng(seed), EventLog("imu"), 0.0
        self.changes_s = []

    def go(self, duration_s, off=None, sigma=RTK, claimed=None, *, correlation_s=0.0, turned_rad=0.25):
        for _ in range(round(duration_s * self.hz)):
            self.t += 1.0 / self.hz
            attitude = gtsam.Rot3.RzRyRx(0.1, -0.05, 0.3 * self.t)
            positions = []
            for name, arm in self.truth.items():
                p_W = attitude.rotate(arm + (off or {}).get(name, 0.0)) + self.rng.normal(0.0, sigma)
                covariance = np.diag(np.square(claimed or sigma))
                positions.append(Position(ns(self.t), name, p_W, covariance, correlation_s))
                for other in positions[:-1]:
                    self.arms.note(
                        positions[-1], other, attitude.compose(gtsam.Rot3.Yaw(turned_rad))
                    )  # a wrong heading
            if self.arms.review(ns(self.t), self.log):
                self.changes_s.append(self.t)
        return self

    @property
    def doubts(self):
        return self.arms.doubts()


@pytest.mark.parametrize("off", [0.5 * ACROSS, -0.5 * ACROSS, 0.5 * ALONG, -0.1 * ALONG, [0.0, 0.0, 0.5]])
@pytest.mark.parametrize("name", ["gnss", "gnss_right"])
def test_a_wrong_arm_is_found_within_seconds_and_both_antennas_are_named(off, name):
    run = Run().go(10.0, {name: np.asarray(off)})
    assert set(run.doubts) == {"gnss", "gnss_right"}
    assert run.changes_s[0] < 8.0 and len(run.changes_s) == 1
    (event,) = run.log.events
    off_m = np.linalg.norm(BASELINE + np.asarray(off) * (1.0 if name == "gnss_right" else -1.0))
    found = re.fullmatch(
        r"the antennas are (.*) m apart, the configuration says (.*) m: "
        r"the translation of the frame of gnss or gnss_right is wrong",
        event.reason,
    )
    assert [float(text) for text in found.groups()] == pytest.approx([off_m, np.linalg.norm(BASELINE)], abs=0.02)


def test_the_doubt_of_an_arm_that_is_off_across_the_baseline_is_by_how_much_it_is_off():
    run = Run().go(10.0, {"gnss": 0.5 * ACROSS})
    assert run.doubts["gnss"] == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("turned_deg", [20.0, 60.0, 120.0])
def test_a_heading_that_was_wrong_and_is_mended_makes_no_baseline_shorter(turned_deg):
    """The means of what is turned by 60 deg half of the time are 1.64 m long where the antennas are 1.9 m apart."""
    run = Run().go(3.0, turned_rad=np.radians(turned_deg)).go(30.0, turned_rad=0.0)
    assert not run.doubts and not run.log.events


def test_a_receiver_that_has_just_stopped_to_lie_does_not_make_its_arm_wrong():
    """From when on an arm is in doubt is a matter of chance; that it is while fixes are right is not."""
    lie = {"gnss": 0.1 * ALONG}
    first_s = Run().go(0.5).go(60.0, lie).changes_s[0]
    assert first_s > 5.0
    run = Run().go(0.5).go(first_s - 0.5 - 0.1, lie).go(30.0)
    assert not run.doubts and not run.log.events


def test_an_arm_that_was_right_stays_right_however_long_its_receiver_lies():
    run = Run().go(1.0).go(120.0, {"gnss": 0.8 * ALONG})
    assert not run.doubts and not run.log.events


def test_a_walk_by_centimetres_after_a_second_of_right_distances_is_no_arm():
    run = Run().go(1.5).go(60.0, {"gnss": 0.08 * ALONG})
    assert not run.doubts and not run.log.events


def test_fixes_that_are_too_vague_to_tell_do_not_make_an_arm_right():
    run = Run().go(5.0, {"gnss": 1.0 * ALONG}, sigma=FLOAT).go(20.0, {"gnss": 1.0 * ALONG})
    assert set(run.doubts) == {"gnss", "gnss_right"}


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("sigma", "claimed", "correlation_s"),
    [
        (RTK, None, 0.25),
        (RTK, (0.02, 0.02, 0.04), 0.0),
        (FLOAT, None, 10.0),
        (FLOAT, (0.15, 0.15, 0.25), 10.0),
        (LOW, None, 0.0),
        (LOW, (0.01, 0.01, 0.02), 0.0),  # what the fixes show counts, not the claim
        ((1.5, 1.5, 2.5), None, 0.25),
    ],
)
def test_no_noise_makes_a_wrong_arm(sigma, claimed, correlation_s, seed):
    run = Run(seed=seed).go(60.0, sigma=sigma, claimed=claimed, correlation_s=correlation_s)
    assert not run.doubts and run.changes_s == [] and run.log.events == []


@pytest.mark.parametrize("off", [0.02 * ALONG, -0.02 * ALONG, 0.1 * ACROSS])
def test_a_mount_that_is_measured_within_2_cm_is_right(off):
    assert not Run().go(60.0, {"gnss": off}).doubts


def test_arms_that_have_been_right_are_right_for_good():
    """Later it is a receiver that lies, not the mount that has changed."""
    run = Run().go(12.0).go(60.0, {"gnss": 0.5 * ALONG})
    assert not run.doubts and run.log.events == []


def test_fixes_that_were_wrong_at_the_start_leave_no_doubt_behind():
    """An ambiguity that was resolved wrongly looks like a wrong arm."""
    run = Run().go(8.0, {"gnss": 0.3 * ALONG})
    assert run.doubts
    run.go(80.0)
    assert not run.doubts and len(run.changes_s) == 2
    assert "after all" in run.log.events[-1].reason


def test_a_third_antenna_says_which_of_two_is_wrong():
    mast = np.array([-1.0, 1.5, 1.4])
    third = {"mast": {"kind": "gnss", "mount": at(mast), "correlation_s": 0.0}}
    run = Run(sensors_of(machine(right=True, more=third)), {**ARMS, "mast": mast})
    run.go(20.0, {"gnss_right": 0.4 * ALONG})
    assert set(run.doubts) == {"gnss_right"}


def test_the_distance_is_the_measured_one_while_in_doubt():
    run = Run().go(10.0, {"gnss_right": 0.5 * ALONG})
    mounted_m = np.linalg.norm(BASELINE)
    assert run.arms.distance_m("gnss_right", "gnss") == pytest.approx(mounted_m + 0.5, abs=0.02)
    assert Run().arms.distance_m("gnss", "gnss_right") == pytest.approx(mounted_m)


def test_an_arm_in_doubt_is_estimated_and_a_heading_that_rests_on_it_tells_nothing():
    run = Run().go(10.0, {"gnss": 0.5 * ACROSS})
    believed, state = run.arms.believed(SENSORS), State(truth(Drive(), 1.0).nav, np.eye(9))
    for name, arm in ARMS.items():
        np.testing.assert_allclose(believed[name].p_I_P, arm)
        np.testing.assert_allclose(believed[name].parameters[0].sigmas, run.doubts[name])
    heading = SENSORS["heading"].convert(Heading(0, 0, "heading", 0.3, 0.01), World())
    assert believed["heading"].innovation(heading, state) is Outcome.BASELINE
    assert believed["heading"].of_imu(heading, gtsam.Rot3()) is None
    assert believed["lidar"] is SENSORS["lidar"]


def test_a_heading_whose_mounting_is_given_does_not_rest_on_the_arms():
    sensors = sensors_of(machine(right=True, heading=True, heading_={"mounting_yaw_deg": 90.0}))
    run = Run(sensors).go(10.0, {"gnss": 0.5 * ACROSS})
    assert run.arms.believed(sensors)["heading"] is sensors["heading"]


def test_a_state_that_rests_on_wrong_arms_is_in_doubt_by_what_they_may_have_done_to_it():
    run, state = Run().go(10.0, {"gnss": 0.5 * ACROSS}), truth(Drive(), 1.0)
    added = np.sqrt(np.diag(run.arms.doubtful(state, 0.1).covariance - state.covariance))
    np.testing.assert_allclose(added[:3], np.arctan2(0.5, np.linalg.norm(BASELINE)), rtol=0.1)
    np.testing.assert_allclose(added[3:6], 0.5, rtol=0.1)
    np.testing.assert_allclose(added[6:], np.repeat([0.0, 0.1, 0.0], 3), atol=1e-9)
    assert Run().arms.doubtful(state, 0.1) is state


@pytest.mark.parametrize("apart_m", [0.0, 1e-15, 1e-9, 1e-6, 1e-4])
def test_two_receivers_that_report_one_position_are_named_once_and_each_may_be_on_either_antenna(apart_m):
    """The direction from one to the other was divided by, and an arm that is off by its length passed as right."""
    together, log = LeverArms(SENSORS), EventLog("imu")
    off = {"gnss_right": ARM - ARM_RIGHT + apart_m * ALONG}
    for k in range(600):
        attitude = gtsam.Rot3.Yaw(0.03 * k)
        one, other = (
            Position(ns(0.1 * k), name, attitude.rotate(arm + off.get(name, 0.0)), np.eye(3) * 1e-4, 0.0)
            for name, arm in ARMS.items()
        )
        together.repeats(one)
        together.repeats(other)
        together.note(other, one, attitude)
        together.review(ns(0.1 * k), log)
    (event,) = log.events
    assert event.reason.startswith("both receivers report the same position, the configuration says 1.78 m apart")
    assert event.stamp_ns < ns(1.0)
    assert together.doubts() == pytest.approx(dict.fromkeys(ARMS, np.linalg.norm(BASELINE)))
    assert together.believed(SENSORS)["heading"] is SENSORS["heading"]  # nothing is said against the mounts


def test_receivers_that_report_one_position_are_named_as_they_arrive_and_each_counts_once_until_they_differ():
    arms, log = LeverArms(SENSORS), EventLog("imu")
    repeated = []
    for k in range(20):
        for name in ARMS:
            at_W = np.array([0.1 * k, 0.0, 1.0 if k >= 15 and name == "gnss" else 0.0])
            repeated.append(arms.repeats(Position(ns(0.1 * k), name, at_W, np.eye(3) * 1e-4, 0.0)))
        arms.review(ns(0.1 * k), log)
    assert len(log.events) == 1 and set(arms.doubts()) == set(ARMS)
    assert repeated == [False] * 10 + [False, True] * 10 + [False] * 10


@pytest.mark.parametrize("length_m", [0.0, 1e-300, 1e-9])
def test_the_variance_along_a_vector_without_a_direction_is_the_largest_of_all(length_m):
    assert variance_along(np.array([length_m, 0.0, 0.0]), np.diag([1.0, 9.0, 4.0])) == pytest.approx(9.0)
    assert variance_along(np.array([0.0, 0.0, 1.0]), np.diag([1.0, 9.0, 4.0])) == pytest.approx(4.0)


def test_two_receivers_on_one_mount_that_report_one_position_count_once_and_cast_no_doubt():
    arms, log = LeverArms(sensors_of(machine(more={"twin": {"kind": "gnss", "mount": at(ARM)}}))), EventLog("imu")
    repeated = []
    for k in range(10):
        repeated += [arms.repeats(Position(ns(k), name, np.zeros(3), np.eye(3), 0.0)) for name in ("gnss", "twin")]
        assert not arms.review(ns(k), log)
    assert repeated[-2:] == [False, True] and len(log.events) == 1 and arms.doubts() == {}
