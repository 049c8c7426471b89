"""An odometry that lies is lost and leads nothing astray; one that says what the fixes say is a witness."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from faults import jumped_gyroscope
from motion import (
    HEADING_DEG,
    Drive,
    StopAndGo,
    fixes,
    horizontal_errors_m,
    imu,
    in_order,
    machine,
    ns,
    run,
    scans,
    seconds,
)

from holdfast.events import EventKind, Outcome

ROAD = Drive(start_s=4.0, ramp_s=4.0, radius_m=20.0, speed=0.3, tilt=0.0, heave_m=0.0)  # 6 m/s
SWINGING = StopAndGo(start_s=4.0, radius_m=20.0, speed=0.3)  # 2 to 10 m/s
RTK = (0.01, 0.01, 0.02)
END_S, LIES_S, RIGHT_S = 48.0, 20.0, 34.0


def streams(end_s=END_S, hz=2.0):
    rng = np.random.default_rng(1)
    return {
        "imu": imu(ROAD, 0.0, end_s, 50.0, rng),
        "gnss": fixes(ROAD, 0.0, end_s, hz, rng, RTK, phase_s=0.0137),
        "lidar": scans(ROAD, 0.0, end_s, 5.0, np.random.default_rng(3), (0.001, 0.01), phase_s=0.0071),
    }


def errors_m(outputs, since_s, road=ROAD):
    return horizontal_errors_m(road, outputs, since_s)


def of_lidar(estimator, kind):
    return [seconds(event.stamp_ns) for event in estimator.events if (event.kind, event.sensor) == (kind, "lidar")]


def stuck(poses, noise_m=0.0):
    rng = np.random.default_rng(7)
    at = next(one for one in poses if one.stamp_ns > ns(LIES_S))

    def held(one):
        return replace(one, position=at.position + rng.normal(0.0, noise_m, 3), quaternion=at.quaternion)

    return [held(one) if ns(LIES_S) < one.stamp_ns < ns(RIGHT_S) else one for one in poses]


def frozen(poses):
    """As in a tunnel: it says that the machine stands."""
    return stuck(poses, 1e-3)


def run_away(poses):
    """Sideways by as much again as the machine moves, and what has been lost stays so."""

    def aside(one):
        since_s = np.clip(seconds(one.stamp_ns) - LIES_S, 0.0, RIGHT_S - LIES_S)
        return replace(one, position=one.position + np.array([0.0, 6.0, 0.0]) * since_s)

    return [aside(one) for one in poses]


@pytest.mark.parametrize("lie", [frozen, run_away])
def test_one_that_lies_is_lost_and_regained_when_it_moves_as_the_estimate(lie):
    """It led the estimate as far away as it went itself, and fixes that were right were refused."""
    sent = streams()
    sent["lidar"] = lie(sent["lidar"])
    estimator, outputs = run(machine(), in_order(*sent.values()))
    (lost_s,), (regained_s,) = (
        of_lidar(estimator, kind) for kind in (EventKind.SENSOR_LOST, EventKind.SENSOR_REGAINED)
    )
    assert LIES_S < lost_s < LIES_S + 2.0
    assert RIGHT_S + 5.0 < regained_s < RIGHT_S + 9.0
    assert max(errors_m(outputs, LIES_S)) < 0.5
    assert EventKind.BEGUN_ANEW not in {event.kind for event in estimator.events}


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_one_that_says_the_same_in_every_digit_says_nothing(scale):
    """However noisy it is: one whose noise was learnt to be much larger was believed for 8 s, and fixes were not."""
    sent = streams()
    sent["lidar"] = stuck(sent["lidar"])
    config = machine(lidar={"translation_sigma_m": 0.02 * scale, "rotation_sigma_rad": 0.002 * scale})
    estimator, outputs = run(config, in_order(*sent.values()))
    lost = [event for event in estimator.events if (event.kind, event.sensor) == (EventKind.SENSOR_LOST, "lidar")]
    assert [event.reason for event in lost] == ["it says the same pose again and again, though the machine has moved"]
    (regained_s,) = of_lidar(estimator, EventKind.SENSOR_REGAINED)
    assert LIES_S < seconds(lost[0].stamp_ns) < LIES_S + 3.0 and RIGHT_S <= regained_s < RIGHT_S + 0.5
    assert max(errors_m(outputs, LIES_S)) < 0.5
    assert estimator.counts["lidar", Outcome.FROZEN] > 60
    kinds = {event.kind for event in estimator.events}
    assert kinds.isdisjoint({EventKind.BEGUN_ANEW, EventKind.RECEIVER_LOST, EventKind.ODOMETRY_SLIP})


def test_one_that_lies_while_fixes_are_rare_is_not_believed_in_a_gap_of_the_imu():
    """The fixes that are to judge it have not come yet; in the gap it alone said that the machine stands: 114 m."""
    sent, gap_s = streams(hz=0.25), (LIES_S + 1.5, LIES_S + 3.0)
    sent["lidar"] = frozen(sent["lidar"])
    sent["imu"] = [one for one in sent["imu"] if not gap_s[0] < seconds(one.stamp_ns) < gap_s[1]]
    estimator, outputs = run(machine(), in_order(*sent.values()))
    assert of_lidar(estimator, EventKind.SENSOR_LOST)
    assert max(errors_m(outputs, LIES_S)) < 0.5
    assert EventKind.BEGUN_ANEW not in {event.kind for event in estimator.events}


def mounted_otherwise(poses, turned):
    """Poses of a lidar that looks elsewhere than the configuration says."""

    def seen(one):
        x, y, z, w = one.quaternion
        q = (turned.compose(gtsam.Rot3.Quaternion(w, x, y, z)).compose(turned.inverse())).toQuaternion()
        xyzw = np.array([q.x(), q.y(), q.z(), q.w()])
        return replace(one, position=turned.rotate(one.position), quaternion=xyzw)

    return [seen(one) for one in poses]


@pytest.mark.parametrize("from_s", [0.0, 5.0])
@pytest.mark.parametrize("angles", [(0.3, 0.2, 1.5), (0.0, 0.0, 3.1)])
def test_one_that_is_mounted_otherwise_is_found_so(from_s, angles):
    """The configuration says where the lidar looks, and is wrong by a right angle or more; at standstill, in motion."""
    sent, turned, outage_s = streams(hz=1.0), gtsam.Rot3.Rodrigues(*angles), 36.0
    sent["lidar"] = mounted_otherwise(sent["lidar"], turned)
    sent["gnss"] = [one for one in sent["gnss"] if one.stamp_ns < ns(outage_s)]
    sent = {name: [one for one in series if one.stamp_ns > ns(from_s)] for name, series in sent.items()}
    heading_deg = HEADING_DEG if from_s == 0.0 else None
    estimator, outputs = run(machine(heading_deg=heading_deg), in_order(*sent.values()))
    regained = [event for event in estimator.events if event.kind is EventKind.SENSOR_REGAINED]
    off_deg = np.degrees(np.linalg.norm(gtsam.Rot3.Logmap(turned)))
    said_deg = float(regained[0].reason.split()[1])
    assert regained[0].reason.endswith("deg otherwise than configured it moves as the estimate")
    assert abs(said_deg - off_deg) < 5.0
    constant = estimator.learnt().constants["lidar"]
    left = gtsam.Rot3.Logmap(gtsam.Rot3.Expmap(np.array(constant.mean[:3])).between(turned.inverse()))
    assert np.degrees(np.linalg.norm(left)) < 2.0
    assert seconds(regained[0].stamp_ns) < 30.0
    assert max(errors_m(outputs, 30.0)) < 2.0  # twelve seconds without GNSS, at 6 m/s


@pytest.mark.parametrize("angles", [(0.35, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.8)])
def test_one_that_would_turn_its_mount_degree_by_degree_is_lost_and_found_so(angles):
    """Where the start and jumps do not show it: the estimate went the other half of the way."""
    sent, turned = streams(30.0, hz=1.0), gtsam.Rot3.Rodrigues(*angles)
    sent["lidar"] = mounted_otherwise(sent["lidar"], turned)
    estimator, outputs = run(machine(heading_deg=HEADING_DEG), in_order(*sent.values()))
    (lost,) = [event for event in estimator.events if event.kind is EventKind.SENSOR_LOST]
    assert "turn its mount further" in lost.reason
    assert seconds(lost.stamp_ns) < ROAD.start_s + ROAD.ramp_s
    (begun,) = [event for event in estimator.events if event.kind is EventKind.BEGUN_ANEW]
    (regained,) = [event for event in estimator.events if event.kind is EventKind.SENSOR_REGAINED]
    assert lost.stamp_ns < begun.stamp_ns < regained.stamp_ns
    assert abs(float(regained.reason.split()[1]) - np.degrees(np.linalg.norm(angles))) < 3.0
    assert max(errors_m(outputs, 10.0)) < 0.2


def elsewhere(poses, arm):
    """Poses of a sensor that is moved by an arm (3,) along its own axes."""

    def moved(one):
        turned = gtsam.Rot3.Quaternion(one.quaternion[3], *one.quaternion[:3])
        return replace(one, position=one.position + turned.rotate(np.array(arm)))

    return [moved(one) for one in poses]


def followed(change):
    """What follows changed poses on a circle at a speed that swings, the last twelve seconds without GNSS."""
    rng, until_s = np.random.default_rng(1), END_S + 12.0
    poses = scans(SWINGING, 0.0, until_s, 5.0, np.random.default_rng(3), (0.001, 0.01), phase_s=0.0071)
    sent = imu(SWINGING, 0.0, until_s, 100.0, rng), fixes(SWINGING, 0.0, END_S, 5.0, rng, RTK, phase_s=0.0137)
    return run(machine(heading_deg=HEADING_DEG), in_order(*sent, change(poses)))


ARMS = (3.0, 0.0, 0.0), (0.0, -2.0, 0.0)


@pytest.mark.parametrize("arm", ARMS)
def test_one_that_is_elsewhere_on_the_machine_is_found_there(arm):
    """A sign of its lever arm is wrong in the file."""
    estimator, outputs = followed(lambda poses: elsewhere(poses, arm))
    (told, *_) = [event for event in estimator.events if "beside where it is configured" in event.reason]
    assert (told.kind, told.sensor) == (EventKind.CALIBRATION, "lidar")
    constants = estimator.learnt().constants
    constant = constants["lidar arm"]
    assert constant.is_off and (np.abs(constant.mean - np.array(arm)) < 3.0 * np.array(constant.sigmas)).all()
    assert max(constant.sigmas[:2]) < 0.5
    assert not constants["lidar scale"].is_off
    assert max(errors_m(outputs, 12.0, SWINGING)) < 0.5  # twelve seconds of it without GNSS
    assert not of_lidar(estimator, EventKind.SENSOR_LOST)


@pytest.mark.parametrize("arm", ARMS)
def test_where_a_circle_at_one_speed_tells_no_arm_from_a_scale_either_serves(arm):
    sent, outage_s = streams(), 36.0
    sent["lidar"] = elsewhere(sent["lidar"], arm)
    sent["gnss"] = [one for one in sent["gnss"] if one.stamp_ns < ns(outage_s)]
    estimator, outputs = run(machine(heading_deg=HEADING_DEG), in_order(*sent.values()))
    told = {event.sensor for event in estimator.events if event.kind is EventKind.CALIBRATION}
    assert "lidar" in told
    assert max(errors_m(outputs, 12.0)) < 0.5  # twelve seconds of it without GNSS, at 6 m/s
    assert not of_lidar(estimator, EventKind.SENSOR_LOST)


@pytest.mark.parametrize("scale", [0.96, pytest.param(1.05, marks=pytest.mark.slow)])
def test_one_whose_distances_are_wrong_is_found_so(scale):
    """Wheels of another size."""
    estimator, outputs = followed(lambda poses: [replace(one, position=scale * one.position) for one in poses])
    constant = estimator.learnt().constants["lidar scale"]
    (log_scale,), (sigma,) = constant.mean, constant.sigmas
    assert constant.is_off and abs(log_scale + np.log(scale)) < 3.0 * sigma and sigma < 0.01
    told = [event.reason for event in estimator.events if event.kind is EventKind.CALIBRATION]
    assert any("multiply `scale` by" in reason for reason in told)
    assert max(errors_m(outputs, 12.0, SWINGING)) < 0.3
    assert not of_lidar(estimator, EventKind.SENSOR_LOST)


def test_of_two_the_one_that_lies_is_left_out_of_a_start():
    sent = {name: [one for one in series if one.stamp_ns > ns(5.0)] for name, series in streams().items()}
    first = sent["lidar"][0]
    camera = [
        replace(one, sensor="camera", position=first.position, quaternion=first.quaternion) for one in sent["lidar"]
    ]
    more = {"camera": {"kind": "odometry", "frame": "lidar"}}
    estimator, outputs = run(machine(heading_deg=None, more=more), in_order(*sent.values(), camera))
    (started,) = [event for event in estimator.events if event.kind is EventKind.INITIALISED]
    assert started.reason.endswith("without camera, at odds with the positions")
    lost = [event.sensor for event in estimator.events if event.kind is EventKind.SENSOR_LOST]
    assert lost == ["camera"]
    assert max(errors_m(outputs, seconds(started.stamp_ns))) < 0.5


def test_a_start_of_few_positions_does_not_rest_on_an_odometry_that_is_at_odds_with_them():
    """Three fixes that are five seconds apart and a lidar that looks the other way: it was 329 m off after 40 s."""
    sent = streams(30.0, hz=0.2)
    sent["lidar"] = mounted_otherwise(sent["lidar"], gtsam.Rot3.Rodrigues(-0.3, 1.4, 2.4))
    sent = {name: [one for one in series if one.stamp_ns > ns(5.0)] for name, series in sent.items()}
    estimator, _ = run(machine(heading_deg=None), in_order(*sent.values()))
    assert not estimator.initialised  # on a circle at one speed the heading is known to 10.3 deg
    told = [event.reason for event in estimator.events if event.kind is EventKind.WAITING]
    assert any(reason.startswith("positions, IMU and odometry are at odds") for reason in told)
    assert estimator.waiting_for.endswith("without lidar, at odds with the positions")


def test_positions_are_no_walk_where_the_lidar_turns_otherwise_than_the_gyroscope():
    """Of a slow machine they left the estimate no faster than fixes walk, and were refused for a minute."""
    slow = Drive(start_s=4.0, ramp_s=4.0, radius_m=8.0, speed=0.1, tilt=0.0, heave_m=0.0)  # 0.8 m/s
    rng, jump_s, end_s = np.random.default_rng(1), 50.0, 75.0
    sent = (
        jumped_gyroscope(imu(slow, 0.0, end_s, 50.0, rng), jump_s, 1.0),
        fixes(slow, 0.0, end_s, 2.0, rng, RTK, phase_s=0.0137),
        scans(slow, 0.0, end_s, 5.0, np.random.default_rng(3), (0.001, 0.01), phase_s=0.0071),
    )
    estimator, outputs = run(machine(heading_deg=HEADING_DEG), in_order(*sent))
    (begun,) = [event for event in estimator.events if event.kind is EventKind.BEGUN_ANEW]
    assert jump_s < seconds(begun.stamp_ns) < jump_s + 12.0
    assert "the bias of the gyroscope has jumped by 1 deg/s" in begun.reason
    assert max(errors_m(outputs, 10.0, slow)) < 0.3


@pytest.mark.parametrize("by_deg_s", [2.0, 4.0])
def test_one_whose_rare_motions_a_gyroscope_contradicts_is_not_lost_where_fixes_say_the_same(by_deg_s):
    jump_s, end_s = 45.0, 70.0
    sent = streams(end_s)
    sent["imu"], sent["lidar"] = jumped_gyroscope(sent["imu"], jump_s, by_deg_s), sent["lidar"][::5]
    estimator, outputs = run(machine(heading_deg=HEADING_DEG), in_order(*sent.values()))
    assert not of_lidar(estimator, EventKind.SENSOR_LOST)
    assert max(errors_m(outputs, jump_s)) < 3.0
    assert max(errors_m(outputs, jump_s + 12.0)) < 0.3


def test_one_that_says_what_the_fixes_say_is_a_witness_against_an_estimate_whose_gyroscope_errs():
    """By default fixes must agree for half a minute beside an odometry that has agreed; it was 30 m off by then."""
    jump_s, end_s = 45.0, 75.0
    sent = streams(end_s)
    sent["imu"] = jumped_gyroscope(sent["imu"], jump_s, 2.0)
    estimator, outputs = run(machine(heading_deg=HEADING_DEG), in_order(*sent.values()))
    begun_s = [seconds(event.stamp_ns) for event in estimator.events if event.kind is EventKind.BEGUN_ANEW]
    assert begun_s and begun_s[0] < jump_s + 12.0
    assert max(errors_m(outputs, begun_s[0] + 5.0)) < 0.2
