"""Two antennas that come by each other's name: in the file, or from some time on."""

from dataclasses import replace

import numpy as np
import pytest
from motion import (
    ARM,
    ARM_RIGHT,
    FigureEight,
    fixes,
    horizontal_errors_m,
    imu,
    in_order,
    machine,
    ns,
    run,
    scans,
)

from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind
from holdfast.messages import GnssFix, Heading
from holdfast.replay.held_out import HeldOutJudge

DRIVE = FigureEight(start_s=4.0, ramp_s=4.0, speed=0.3)  # up to 8 m/s
END_S = 25.0
OTHER = {"gnss": "gnss_right", "gnss_right": "gnss"}


def recorded(exchanged_s, *, lidar=False, heading=None):
    """A drive with two antennas that are exchanged in a time (start, end); `heading` says how headings are turned."""
    rng = np.random.default_rng(2)
    sent = [
        imu(DRIVE, 0.0, END_S, 100.0, rng),
        fixes(DRIVE, 0.0, END_S, 5.0, rng),
        fixes(DRIVE, 0.0, END_S, 5.0, rng, arm=ARM_RIGHT, sensor="gnss_right"),
    ]
    if lidar:
        sent.append(scans(DRIVE, 0.0, END_S, 5.0, rng, (0.001, 0.01), phase_s=0.0071))
    if heading is not None:
        sent.append(headings(rng, heading))
    since, until = map(ns, exchanged_s)
    return [
        replace(one, sensor=OTHER[one.sensor]) if isinstance(one, GnssFix) and since <= one.stamp_ns < until else one
        for one in in_order(*sent)
    ]


def headings(rng, turned_rad):
    """What a receiver says of the direction from the first antenna to the second."""
    told = []
    for t in np.arange(0.05, END_S, 0.2):
        x, y, _ = DRIVE.nav(t).attitude().rotate(ARM_RIGHT - ARM)
        yaw = np.arctan2(y, x) + turned_rad + rng.normal(0.0, 0.005)
        told.append(Heading(ns(t), ns(t), "heading", float(np.remainder(yaw, 2.0 * np.pi)), 0.005))
    return told


def driven(exchanged_s, *, lidar=False, heading=None):
    config = machine(lidar=lidar, right=True, heading=heading is not None, heading_deg=None)
    estimator, outputs = run(config, recorded(exchanged_s, lidar=lidar, heading=heading))
    told = [one for one in estimator.events if one.kind is EventKind.LEVER_ARM]
    return estimator, outputs, told


@pytest.mark.parametrize("lidar", [False, True])
def test_a_file_with_the_names_of_two_antennas_exchanged_turns_the_machine_until_it_moves(lidar):
    _, outputs, told = driven((0.0, END_S), lidar=lidar)
    assert max(horizontal_errors_m(DRIVE, outputs, 12.0)) < 0.1
    assert [one.sensor for one in told] == ["gnss, gnss_right"]
    assert "exchanged" in told[0].reason
    assert told[0].stamp_ns < ns(9.0)


@pytest.mark.parametrize("lidar", [False, True])
def test_antennas_that_are_exchanged_on_the_way_and_back_cost_nothing(lidar):
    estimator, outputs, told = driven((12.0, 18.0), lidar=lidar)
    assert max(horizontal_errors_m(DRIVE, outputs, 10.0)) < 0.1
    assert [one.reason.split(":")[0] for one in told] == [
        "each is where the file has the other",
        "each is where the file says again",
    ]
    assert not {EventKind.BEGUN_ANEW, EventKind.GNSS_LOST} & {one.kind for one in estimator.events}


def test_antennas_that_are_right_are_not_exchanged():
    estimator, outputs, told = driven((END_S, END_S))
    assert max(horizontal_errors_m(DRIVE, outputs, 5.0)) < 0.05
    assert not told
    assert EventKind.BEGUN_ANEW not in {one.kind for one in estimator.events}


def test_antennas_on_the_other_side_of_the_imu_are_elsewhere_and_not_exchanged():
    """Exchanged, on a machine that is turned by half a circle, they look nearly the same."""
    rng = np.random.default_rng(2)
    shift = -(ARM + ARM_RIGHT) * (1.0, 1.0, 0.0)
    sent = [
        imu(DRIVE, 0.0, END_S, 100.0, rng),
        fixes(DRIVE, 0.0, END_S, 5.0, rng, arm=ARM + shift),
        fixes(DRIVE, 0.0, END_S, 5.0, rng, arm=ARM_RIGHT + shift, sensor="gnss_right"),
    ]
    estimator, outputs = run(machine(lidar=False, right=True, heading_deg=None), in_order(*sent))
    assert max(horizontal_errors_m(DRIVE, outputs, 12.0)) < 0.1
    assert not [one for one in estimator.events if "exchanged" in one.reason]
    assert [one for one in estimator.events if "beside where it is configured" in one.reason]


@pytest.mark.parametrize("turned_rad", [np.pi, 0.0])
def test_headings_between_exchanged_antennas_are_used_whoever_has_exchanged_what(turned_rad):
    """Translations or cables: the heading is the other way round than the axis; topics: it is as the file says."""
    estimator, outputs, told = driven((0.0, END_S), heading=turned_rad)
    assert max(horizontal_errors_m(DRIVE, outputs, 12.0)) < 0.1
    assert len(told) == 1
    later = {one.kind for one in estimator.events if one.stamp_ns > ns(10.0)}
    assert not later & {EventKind.SENSOR_LOST, EventKind.RECEIVER_LOST, EventKind.BEGUN_ANEW}


def test_held_out_fixes_are_judged_by_the_antenna_that_they_are_of():
    config, messages = machine(lidar=False, right=True, heading_deg=None), recorded((0.0, END_S))
    estimator = Estimator(config)
    judge = HeldOutJudge(config, estimator)
    for message in messages:
        if isinstance(message, GnssFix) and (message.stamp_ns - ns(0.0)) % 400_000_000 >= 200_000_000:
            judge.add_message(message, False)
            continue
        output = estimator.process(message)
        if output.estimate is not None:
            judge.add_estimate(output.estimate, estimator.world)
    off_m = [float(np.hypot(*one.error[:2])) for one in judge.judgements if one.stamp_ns > ns(12.0)]
    assert len(off_m) > 20
    assert max(off_m) < 0.1


def test_what_was_found_is_known_at_the_start_of_the_next_day():
    before, _, _ = driven((0.0, END_S))
    estimator, outputs = run(
        machine(lidar=False, right=True, heading_deg=None), recorded((0.0, END_S)), before.learnt()
    )
    assert max(horizontal_errors_m(DRIVE, outputs, 1.5)) < 0.1
    assert EventKind.BEGUN_ANEW not in {one.kind for one in estimator.events}
