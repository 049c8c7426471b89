# ruff: noqa: PLR0917 - a story is many small choices with defaults
"""An estimate that is wrong is found by fixes that agree among themselves, and begun anew from them, in motion too."""

import itertools
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from faults import jumped_gyroscope
from motion import (
    HEADING_DEG,
    Drive,
    estimates,
    fix_at,
    fixes,
    horizontal_errors_m,
    imu,
    in_order,
    machine,
    ns,
    prisms,
    run,
    scans,
    seconds,
    velocities,
)

from holdfast.events import EventKind, Health

ROAD = Drive(start_s=4.0, ramp_s=4.0, radius_m=20.0, speed=0.3, tilt=0.0, heave_m=0.0)  # 6 m/s
RTK, CONSUMER = (0.01, 0.01, 0.02), (0.4, 0.4, 0.8)
DOPPLER = {"doppler": {"kind": "gnss_velocity", "frame": "gnss"}}
RECEIVERS = pytest.mark.parametrize(
    ("sigma", "hz", "doppler"), [(RTK, 10.0, False), (CONSUMER, 10.0, False), (CONSUMER, 1.0, True)]
)


def streams(sigma, hz, doppler, end_s, seed=1, motion=ROAD):
    rng = np.random.default_rng(seed)
    found = {
        "imu": imu(motion, 0.0, end_s, 50.0, rng),
        "gnss": fixes(motion, 0.0, end_s, hz, rng, sigma, phase_s=0.0137),
    }
    return found | ({"doppler": velocities(motion, 0.0, end_s, rng=rng)} if doppler else {})


def thrown(sent, lost_s, back_s):
    """All but the IMU silent between two times, in which it reads 15 m/s^2 too much along x."""
    push = np.array([15.0, 0.0, 0.0])
    found = {}
    for name, messages in sent.items():
        inside = [ns(lost_s) < one.stamp_ns < ns(back_s) for one in messages]
        if name == "imu":
            found[name] = [
                replace(one, specific_force=one.specific_force + push) if is_in else one
                for one, is_in in zip(messages, inside, strict=True)
            ]
        else:
            found[name] = [one for one, is_in in zip(messages, inside, strict=True) if not is_in]
    return found


def beginnings_s(estimator):
    return [seconds(event.stamp_ns) for event in estimator.events if event.kind is EventKind.BEGUN_ANEW]


def errors_m(outputs, since_s, motion=ROAD):
    return horizontal_errors_m(motion, outputs, since_s)


def largest_step_m(outputs, since_s=0.0):
    """By how much T_O_I arrives elsewhere than where the state published before leads it."""
    worst = 0.0
    for a, b in itertools.pairwise([e for e in estimates(outputs) if e.stamp_ns > ns(since_s)]):
        dt_s = (b.stamp_ns - a.stamp_ns) * 1e-9
        T_O_a, T_O_b = (e.T_W_O.inverse() * e.nav.pose() for e in (a, b))
        led = T_O_a.translation() + a.T_W_O.rotation().unrotate(a.nav.velocity()) * dt_s
        worst = max(worst, float(np.linalg.norm(T_O_b.translation() - led)))
    return worst


def assert_found(estimator, outputs, sent, sigma, wrong_s, limit_s):
    """Found in time, right again within 5 s of the fifth fix after it, and O does not step."""
    found = beginnings_s(estimator)
    assert found and found[-1] < wrong_s + limit_s
    fifth_s = seconds([fix.stamp_ns for fix in sent["gnss"] if fix.stamp_ns > ns(found[-1])][4])
    assert max(errors_m(outputs, fifth_s + 5.0)) < 3.0 * np.hypot(*sigma[:2])
    assert largest_step_m(outputs, wrong_s) < 5e-3  # thrown, it moves by 1.8 m from sample to sample


@RECEIVERS
def test_a_heading_that_is_wrong_by_60_deg_is_found_within_a_minute(sigma, hz, doppler):
    sent = streams(sigma, hz, doppler, 34.0)
    wrong = {"heading_deg": HEADING_DEG + 60.0, "initialisation": {"heading_sigma_deg": 2.0}}
    config = machine(lidar=False, more=DOPPLER if doppler else None, **wrong)
    estimator, outputs = run(config, in_order(*sent.values()))
    assert_found(estimator, outputs, sent, sigma, ROAD.start_s, 60.0)


def test_a_wrong_heading_is_found_beside_a_lidar_that_cannot_know_it():
    sent = streams(RTK, 5.0, False, 46.0)
    sent["lidar"] = scans(ROAD, 0.0, 46.0, 5.0, np.random.default_rng(3), (0.001, 0.01), phase_s=0.0071)
    config = machine(heading_deg=HEADING_DEG + 60.0, initialisation={"heading_sigma_deg": 2.0})
    estimator, outputs = run(config, in_order(*sent.values()))
    assert_found(estimator, outputs, sent, RTK, ROAD.start_s, 60.0)


def test_a_receiver_that_never_measures_does_not_speak_for_an_estimate_that_a_prism_contradicts():
    """It was trusted for its first 20 s, and the lidar was found to agree meanwhile with what it led alone."""
    rng = np.random.default_rng(1)
    sent = imu(ROAD, 0.0, 25.0, 50.0, rng), prisms(ROAD, 0.0, 25.0, rng=rng)
    lidar = scans(ROAD, 0.0, 25.0, 5.0, rng, phase_s=0.0071)
    config = machine(heading_deg=HEADING_DEG + 30.0, more={"prism": {"kind": "prism", "frame": "gnss"}})
    _, outputs = run(config, in_order(*sent, lidar))
    assert max(errors_m(outputs, 15.0)) < 0.1


@RECEIVERS
def test_a_state_that_was_thrown_a_kilometre_away_is_found_when_fixes_return(sigma, hz, doppler):
    """15 m/s^2 in readings that nothing contradicts, for 12 s without GNSS, are more than a kilometre."""
    back = 27.0
    end_s = 48.0 if doppler else 42.0  # one fix a second takes longer
    sent = thrown(streams(sigma, hz, doppler, end_s), 15.0, back)
    config = machine(lidar=False, more=DOPPLER if doppler else None)
    estimator, outputs = run(config, in_order(*sent.values()))
    assert max(errors_m(outputs, 15.0)) > 100.0
    assert_found(estimator, outputs, sent, sigma, back, 10.0)


def test_a_state_that_was_thrown_away_is_found_also_beside_a_lidar_that_had_agreed_before():
    """Lidar and GNSS return together and both contradict the estimate: it was 8 km away a minute later."""
    back, patience_s = 50.0, 6.0
    sent = streams(RTK, 5.0, False, 70.0)
    sent["lidar"] = scans(ROAD, 0.0, 70.0, 5.0, np.random.default_rng(3), (0.001, 0.01), phase_s=0.0071)
    sent = thrown(sent, 40.0, back)
    estimator, outputs = run(machine(gate={"believe_after_s": patience_s}), in_order(*sent.values()))
    assert_found(estimator, outputs, sent, RTK, back, patience_s + 4.0)


@RECEIVERS
def test_a_gyroscope_whose_bias_jumps_is_found_out(sigma, hz, doppler):
    """Each beginning took the bias of the first standstill for right, and was wrong again."""
    sent = streams(sigma, hz, doppler, 60.0)
    sent["imu"] = jumped_gyroscope(sent["imu"], 20.0, 2.0)
    _, outputs = run(machine(lidar=False, more=DOPPLER if doppler else None), in_order(*sent.values()))
    assert max(errors_m(outputs, 50.0)) < max(0.5, 5.0 * np.hypot(*sigma[:2]))


@pytest.mark.parametrize("hz", [1.0, 0.2])
def test_velocities_that_have_proven_right_tell_at_once_that_the_gyroscope_jumped(hz):
    """With a position every 5 s the estimate ran 1.6 km away until enough of them had come since."""
    sent = streams(CONSUMER, hz, True, 90.0)
    sent["imu"] = jumped_gyroscope(sent["imu"], 60.0, 2.0)
    estimator, outputs = run(machine(lidar=False, more=DOPPLER), in_order(*sent.values()))
    (begun,) = [event for event in estimator.events if event.kind is EventKind.BEGUN_ANEW]
    assert "the bias of the gyroscope has jumped by" in begun.reason
    assert 60.0 < seconds(begun.stamp_ns) < 70.0
    assert max(errors_m(outputs, 30.0)) < 10.0
    assert max(errors_m(outputs, 75.0)) < 3.0 * np.hypot(*CONSUMER[:2])


def by(change):
    """Velocities that are changed."""
    return lambda sent: [replace(one, velocity=change(one.velocity)) for one in sent]


def a_second_late(sent):
    return [
        replace(one, velocity=before.velocity)
        for before, one in itertools.pairwise(sent[::5])  # 5 Hz
    ]


@pytest.mark.parametrize("wrong", [by(lambda v: -v), by(lambda v: 0.0 * v), by(lambda v: v[[1, 0, 2]]), a_second_late])
def test_velocities_that_lead_elsewhere_than_the_positions_spoil_nothing_for_long(wrong):
    """Of the other sign it was 100 m off, with perfect fixes; late by a second they spoilt every beginning anew."""
    sent = streams(CONSUMER, 1.0, True, 60.0)
    sent["doppler"] = wrong(sent["doppler"])
    config = machine(lidar=False, more=DOPPLER, heading_deg=None)
    estimator, outputs = run(config, in_order(*sent.values()))
    assert estimator.initialised
    assert max(errors_m(outputs, 40.0)) < 5.0 * np.hypot(*CONSUMER[:2])
    assert estimator.health is Health.SENSOR_LOST


def far(fix, offset_m):
    """The same fix, some metres beside."""
    t = seconds(fix.stamp_ns)
    return fix_at(ROAD, t, np.array([0.0, offset_m, 0.0]), RTK)


def knocked(sent, at_s):
    """An IMU that is turned by 60 deg from one sample to the next, which its gyroscope does not see."""
    R = gtsam.Rot3.Rodrigues(*np.radians([36.0, -30.0, 37.0])).matrix()

    def turned(one):
        return replace(one, angular_velocity=R @ one.angular_velocity, specific_force=R @ one.specific_force)

    return [turned(one) if one.stamp_ns > ns(at_s) else one for one in sent]


def test_velocities_that_say_what_the_fixes_say_make_two_of_these_enough():
    """Gravity pushes by 8 m/s^2: within the five seconds that five fixes take it was 112 m off."""
    sent = streams(CONSUMER, 1.0, True, 60.0)
    sent["imu"] = knocked(sent["imu"], 30.0)
    estimator, outputs = run(machine(lidar=False, more=DOPPLER), in_order(*sent.values()))
    assert beginnings_s(estimator)[0] < 30.0 + 3.5
    assert max(errors_m(outputs, 30.0)) < 0.5 * 9.81 * 3.5**2
    assert max(errors_m(outputs, 45.0)) < 5.0 * np.hypot(*CONSUMER[:2])


def test_a_jump_of_the_fixes_that_the_velocities_do_not_confirm_is_no_contradiction_of_two():
    sent = streams(CONSUMER, 1.0, True, 40.0)
    sent["gnss"] = [far(one, 40.0) if ns(30.0) < one.stamp_ns < ns(33.5) else one for one in sent["gnss"]]
    estimator, outputs = run(machine(lidar=False, more=DOPPLER), in_order(*sent.values()))
    assert not beginnings_s(estimator)
    assert max(errors_m(outputs, 30.0)) < 5.0 * np.hypot(*CONSUMER[:2])


def driven(lidar, liar, from_s, end_s, **gate):
    """Fixes that lie from a time on, `liar(t)` metres aside; events and outputs."""
    sent = streams(RTK, 5.0, False, end_s)
    sent["gnss"] = [far(one, liar(seconds(one.stamp_ns))) if one.stamp_ns > ns(from_s) else one for one in sent["gnss"]]
    if lidar:
        sent["lidar"] = scans(ROAD, 0.0, end_s, 5.0, np.random.default_rng(3), (0.001, 0.01), phase_s=0.0071)
    return run(machine(lidar=lidar, gate=gate), in_order(*sent.values()))


@pytest.mark.parametrize(
    ("lidar", "believe_after_s", "patience_s"),
    [(False, None, 5.0), (False, 6.0, 6.0), (True, 6.0, 6.0), (True, None, 30.0)],
)
def test_fixes_that_jump_aside_are_believed_after_the_time_that_is_configured(lidar, believe_after_s, patience_s):
    """With and without lidar; by default five seconds, or half a minute beside an odometry."""
    end_s = 10.0 + patience_s + 4.0
    estimator, outputs = driven(lidar, lambda _: 8.0, 10.0, end_s, believe_after_s=believe_after_s)
    found_s, *_settled_s = beginnings_s(estimator)
    assert 10.0 + patience_s <= found_s < 10.0 + patience_s + 2.0
    assert largest_step_m(outputs) < 2e-3
    assert np.mean(errors_m(outputs, end_s - 1.0)) == pytest.approx(8.0, abs=0.2)


def test_a_liar_that_walks_away_is_not_believed_beside_an_odometry_that_vouches():
    """0.3 m/s; fixes are refused from 50.4 s on, so that half a minute is over at 80 s at the earliest."""
    walk_s, end_s = 50.0, 80.0
    estimator, outputs = driven(True, lambda t: 0.3 * (t - walk_s), walk_s, end_s)
    assert EventKind.RECEIVER_LOST in {event.kind for event in estimator.events}
    assert beginnings_s(estimator) == []
    assert max(errors_m(outputs, walk_s)) < 3.0


def test_a_clock_of_gnss_that_is_far_off_is_found_and_kept():
    """It looked like biases that had jumped, one after another; on a real drive the estimate began anew ten times."""
    sent = streams(RTK, 5.0, True, 60.0)
    for name in ("gnss", "doppler"):
        sent[name] = [replace(one, stamp_ns=one.stamp_ns - 250_000_000) for one in sent[name]]
    config = machine(lidar=False, more=DOPPLER, heading_deg=None)
    estimator, outputs = run(config, in_order(*sent.values()))
    (begun,) = [event for event in estimator.events if event.kind is EventKind.BEGUN_ANEW]
    assert "stamps of GNSS are 0.2" in begun.reason and seconds(begun.stamp_ns) < 10.0
    clock = estimator.learnt().constants["clock of GNSS"]
    assert clock.is_off and clock.mean[0] == pytest.approx(0.25, abs=0.05)  # on a circle an arm looks like it
    assert max(errors_m(outputs, 20.0)) < 0.5
