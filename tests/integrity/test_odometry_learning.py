"""What is learnt of the noise and the drift of an odometry, rotation and translation apart."""

from dataclasses import replace
from functools import cache
from math import atan2

import gtsam
import numpy as np
import pytest
from faults import jumped_gyroscope
from motion import ARM, ARM_RIGHT, Drive, imu, machine, ns, seconds
from rig import Rig, position

from holdfast.events import EventKind
from holdfast.graph.odometry_track import believed_calibration
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.integrity.noise_review import NoiseReview
from holdfast.integrity.odometry_learning import LOWEST_TILT
from holdfast.sensors.heading import AxisYaw
from holdfast.sensors.odometry import LearntNoise, TrackPose

END_S = 60.0
DRIVE = Drive(start_s=-3.0)
JITTER = 0.002, 0.02  # as configured, between two poses: rotation [rad], translation [m]
DRIFT = 0.005, 0.04  # per root of rad, of m


def poses(noise, drift, seed=3, worse_from_s=np.inf, end_s=END_S):
    """Poses of a lidar, its noise and its drift so many times that configured; ten times more from a time on."""
    rng, track, last = np.random.default_rng(seed), gtsam.Pose3(), DRIVE.pose(0.1)
    for t in np.arange(0.1, end_s, 0.2):
        worse = 10.0 if t > worse_from_s else 1.0
        motion, last = last.between(DRIVE.pose(t)), DRIVE.pose(t)
        rotation = np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation()))
        sigmas = np.repeat([DRIFT[0] * np.sqrt(rotation), DRIFT[1] * np.sqrt(np.linalg.norm(motion.translation()))], 3)
        track = track * motion * gtsam.Pose3.Expmap(worse * drift * sigmas * rng.standard_normal(6))
        jitter = worse * noise * np.repeat(JITTER, 3) / np.sqrt(2.0) * rng.standard_normal(6)
        yield t, TrackPose(ns(t), "lidar", track * gtsam.Pose3.Expmap(jitter))


def known(rig):
    """What is known of the lidar."""
    noise = rig.odometries.noises["lidar"]
    return LearntNoise(*(noise.scale * one for one in noise.learnt))


def learnt(noise, drift, **how):
    """What is known of the lidar in the end."""
    return known(driven(noise, drift, **how))


def driven(noise, drift, *, end_s=END_S, **how):
    """All that has learnt until the end."""
    (rig,) = stages(noise, drift, [end_s], **how)
    return rig


def stages(
    noise, drift, ends_s, *, worse_from_s=np.inf, walk_from_s=np.inf, early_s=0.0, carried=NOTHING_LEARNT, samples=None
):
    """Yield all that has learnt at each of these times, with a fix every second; they walk from a time on.

    The stamps of the lidar are by so much earlier than it measured.
    """
    rig = Rig(DRIVE, machine(), max(ends_s[-1], 1.0), samples=samples, carried=carried)
    due_s = begin_s = 0.0
    for end_s in ends_s:
        for t, pose in poses(noise, drift, worse_from_s=worse_from_s, end_s=end_s):
            if t < begin_s + early_s:
                continue  # was driven before
            seen = replace(pose, stamp_ns=pose.stamp_ns - round(early_s * 1e9))
            rig.odometries.add(rig.graph, seen, seen.stamp_ns)
            if t >= due_s:
                off = 0.1 * max(0.0, t - walk_from_s), 0.0, 0.0
                rig.positions.add(rig.graph, position(DRIVE, t, ARM, off), ns(t))
                due_s += 1.0
                rig.update()
                rig.recovery.review(rig.graph, seen.stamp_ns)
        begin_s = end_s
        yield rig


@cache
def driven_once(noise, drift):
    """The same for tests that only look at it, or take the events."""
    return driven(noise, drift)


@pytest.mark.parametrize("noise, drift", [(0.5, 0.5), (1.0, 1.0), (2.0, 2.0)])
def test_noise_and_drift_are_found_in_both_directions(noise, drift):
    found = known(driven_once(noise, drift))
    assert found.rotation_noise == pytest.approx(noise, rel=0.35)
    assert found.translation_noise == pytest.approx(noise, rel=0.35)
    assert found.translation_drift == pytest.approx(drift, rel=0.5)


@pytest.mark.parametrize("early_s", [0.1, -0.1])
def test_a_clock_that_is_found_is_no_drift(early_s):
    """Rotations were compared with the gyroscope at the stamps: 2.0 and 2.3 times the drift that there is."""
    rig = driven(1.0, 1.0, early_s=early_s)
    calibration = rig.odometries._odometries["lidar"].model.calibration
    assert believed_calibration(rig.graph.main, "lidar", calibration)[-1] == pytest.approx(early_s, abs=0.02)
    assert known(rig).tilt_drift == pytest.approx(1.0, rel=0.5)
    assert known(rig).rotation_noise < 1.5


def kept(rig):
    """What is carried over a restart, as it comes back from a file."""
    snapshot = LearntSnapshot(odometries=rig.odometries.learnt())
    return LearntSnapshot.model_validate_json(snapshot.model_dump_json())


@pytest.mark.parametrize("noise, drift", [(0.5, 0.5), (4.0, 4.0)])
def test_what_is_carried_over_a_restart_holds_from_the_first_pose(noise, drift):
    before = driven_once(noise, drift)
    at_once = learnt(noise, drift, end_s=0.0, carried=kept(before))
    scale = before.odometries.noises["lidar"].scale
    for was, now in zip(before.odometries.noises["lidar"].learnt, at_once, strict=True):
        assert now == pytest.approx(scale * was, rel=0.3)
    assert learnt(noise, drift, end_s=0.0).translation_noise == 1.0  # of itself it would not know


@pytest.mark.parametrize("before, now", [(4.0, 0.5), (0.5, 4.0)])
def test_an_odometry_that_has_changed_overnight_is_learnt_within_minutes(before, now):
    found = learnt(now, now, end_s=120.0, carried=kept(driven_once(before, before)))
    assert found.rotation_noise == pytest.approx(now, rel=0.5)
    assert found.translation_noise == pytest.approx(now, rel=0.5)
    assert found.translation_drift == pytest.approx(now, rel=0.6)
    assert found.tilt_drift == pytest.approx(max(now, LOWEST_TILT), rel=0.5)


def test_an_odometry_whose_noise_is_trebled_keeps_what_was_learnt_before():
    before = driven_once(4.0, 4.0)
    rig = Rig(DRIVE, machine(), 1.0, carried=kept(before))
    noise, one = rig.odometries.noises["lidar"], rig.odometries._odometries["lidar"]
    known = [noise.scale * value for value in noise.learnt]
    one.learning.trust_less(3.0)
    assert noise.scale == 3.0
    assert [3.0 * value for value in noise.learnt][:4] == pytest.approx(known[:4], rel=0.15)


def test_what_is_far_from_the_file_is_told_once():
    rig = driven_once(1.0, 4.0)
    rig.log.take_events()
    review = NoiseReview("imu", rig.log)
    for t in range(10, 200):
        review.review(rig.odometries, None, ns(t))
    told = [event.reason for event in rig.log.take_events() if event.kind is EventKind.CALIBRATION]
    named = [one.split(":")[0] for one in told]
    assert len(named) == len(set(named)) and {"rotation drift", "translation drift"} <= set(named)
    (words,) = [one for one in told if one.startswith("rotation drift")]
    assert words.endswith("times more than drift_rad_per_sqrt_rad says")
    assert float(words.split()[2]) == pytest.approx(4.0, rel=0.35)


def test_what_is_as_the_file_says_is_not_told():
    rig = driven_once(1.0, 1.0)
    rig.log.take_events()
    NoiseReview("imu", rig.log).review(rig.odometries, None, ns(100.0))
    assert rig.log.take_events() == []


def test_a_rotation_that_drifts_faster_is_found_and_one_that_agrees_is_hardly_trusted_more():
    assert known(driven_once(1.0, 4.0)).tilt_drift == pytest.approx(4.0, rel=0.35)
    assert learnt(0.3, 0.1, end_s=40.0).tilt_drift == LOWEST_TILT


def test_an_odometry_that_gets_bad_is_trusted_less_again():
    good, bad = map(known, stages(0.3, 0.2, [40.0, 60.0], worse_from_s=40.0))
    assert bad.translation_noise > 2.0 * good.translation_noise and bad.rotation_noise > 2.0 * good.rotation_noise


def test_a_walk_of_the_fixes_does_not_teach():
    before, walking = map(known, stages(0.3, 0.2, [45.0, 60.0], walk_from_s=45.0))
    assert walking.translation_drift < 1.3 * before.translation_drift


def test_without_fixes_nothing_is_learnt_of_distances():
    rig = Rig(DRIVE, machine(), 30.0)
    for t, pose in poses(0.5, 0.25):
        if t < 30.0:
            rig.odometries.add(rig.graph, pose, ns(t))
    found = rig.odometries.noises["lidar"].learnt
    assert found.translation_drift == pytest.approx(1.0, rel=0.01) and found.translation_noise < 0.8


def yaw_learnt(
    *, gyroscope_wrong=1.0, odometry_wrong=1.0, headings=True, antennas=1, wrong_file=(1.0, 1.0), end_s=90.0
):
    """How wrong gyroscope and odometry are told to be about the vertical, in units of what they are.

    The gyroscope has the error of the default times a factor, as has the odometry; `wrong_file` is what the file makes
    of both. The gyroscope errs in proportion to the rate, otherwise in each second.
    """
    ratio, drift = 0.003, DRIFT[0]
    imu_section = {"gyroscope_error_ratio": ratio * wrong_file[0], "gyroscope_noise_density": 1e-4 * wrong_file[0]}
    lidar = {"drift_rad_per_sqrt_rad": drift * wrong_file[1]}
    config = machine(heading=headings, right=antennas == 2, imu_=imu_section, lidar_=lidar)
    rng = np.random.default_rng(0)
    errors = 1.0 + gyroscope_wrong * ratio * rng.standard_normal(int(end_s) + 1)
    samples = [
        replace(one, angular_velocity=one.angular_velocity * errors[int(seconds(one.stamp_ns))])
        for one in imu(DRIVE, 0.0, end_s)
    ]
    rig, due_s = Rig(DRIVE, config, end_s, samples=samples), 0.0
    for t, pose in poses(1.0, odometry_wrong, end_s=end_s):
        rig.odometries.add(rig.graph, pose, pose.stamp_ns)
        if headings:
            x, y, _ = DRIVE.nav(t).attitude().rotate(np.array([1.0, 0.0, 0.0]))
            rig.headings.add(rig.graph, AxisYaw(ns(t), "heading", atan2(y, x) + rng.normal(0.0, 0.003), 0.003), ns(t))
        if antennas == 2:
            for sensor, arm in (("gnss", ARM), ("gnss_right", ARM_RIGHT)):
                off = rng.normal(0.0, 0.005, 3)
                rig.positions.add(rig.graph, position(DRIVE, t, arm, off, sensor, 0.005), ns(t))
        if t >= due_s:
            if antennas == 1:
                rig.positions.add(rig.graph, position(DRIVE, t, ARM), ns(t))
            rig.update()
            due_s += 1.0
    gyroscope = rig.graph.main.imu_noise.yaw_scale * wrong_file[0] / gyroscope_wrong
    return gyroscope, rig.odometries.noises["lidar"].learnt.yaw_drift * wrong_file[1] / odometry_wrong


@pytest.mark.parametrize("wrong_file", [(10.0, 1.0), (1.0, 0.1), (1.0, 10.0)])
def test_headings_tell_whether_gyroscope_or_odometry_is_wrong_whatever_the_file_says(wrong_file):
    gyroscope, odometry = yaw_learnt(wrong_file=wrong_file)
    assert 0.3 < gyroscope < 3.0 and 0.3 < odometry < 3.0


@pytest.mark.parametrize("wrong_file", [(10.0, 1.0), (1.0, 0.1)])
def test_two_antennas_tell_it_too_where_no_receiver_says_a_heading(wrong_file):
    gyroscope, odometry = yaw_learnt(headings=False, antennas=2, wrong_file=wrong_file)
    assert 0.3 < gyroscope < 3.0 and 0.3 < odometry < 3.0


def test_a_gyroscope_that_is_far_worse_than_the_file_says_is_found():
    gyroscope, odometry = yaw_learnt(gyroscope_wrong=10.0)
    assert 0.4 < gyroscope < 2.5 and 0.3 < odometry < 3.0


def test_without_headings_both_keep_the_ratio_of_the_file():
    gyroscope, odometry = yaw_learnt(headings=False)
    assert gyroscope == pytest.approx(odometry, rel=0.5)


def parted_s(by_deg_s, jump_s=40.0):
    """The seconds at which a lidar has turned otherwise than a gyroscope whose bias jumps."""
    ends_s, samples = np.arange(1.0, END_S), jumped_gyroscope(imu(DRIVE, 0.0, END_S), jump_s, by_deg_s)
    rigs = stages(1.0, 1.0, ends_s, samples=samples)
    return [end_s for end_s, rig in zip(ends_s, rigs, strict=True) if rig.odometries.part_from_gyroscope(ns(end_s))]


def test_a_lidar_parts_from_a_gyroscope_whose_bias_jumps():
    assert 40.0 < parted_s(2.0)[0] <= 44.0
    assert parted_s(0.0) == []
