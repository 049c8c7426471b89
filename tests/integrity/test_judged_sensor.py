"""Measurements that one state explains: into both graphs if they agree, named and recounted if they do not."""

import numpy as np
import pytest
from motion import ARM, Drive, at, machine, ns, twists
from rig import Rig, position

from holdfast.events import EventKind, Outcome
from holdfast.integrity.noise_scale import NoiseScale
from holdfast.integrity.states import JudgedSensor
from holdfast.sensors.height import PointHeight
from holdfast.sensors.sensor import Joint

DRIVE = Drive(start_s=-3.0)
LASER = {"kind": "height", "mount": at(ARM), "sigma_m": 0.01, "correlation_s": 0.0}
WHEELS = {"kind": "twist", "mount": at([0.0, 0.0, 0.0]), "scale_sigma": 0.0}


def begun(laser=LASER, until_s=0.0, **config):
    rig = Rig(DRIVE, machine(more={"laser": laser}, **config), 12.0)
    for t in np.arange(0.1, until_s, 0.1):
        assert receive(rig, height(t)) is Outcome.USED
    return rig


def height(t, off_m=0.0, sigma_m=0.01):
    return PointHeight(ns(t), "laser", float(DRIVE.pose(t).transformFrom(ARM)[2]) + off_m, sigma_m)


def receive(rig, measured):
    """Take a measurement in as `Tracking` does."""
    outcome = rig.states.add(rig.graph, measured, measured.stamp_ns)
    rig.log.count(measured.sensor, outcome)
    rig.update()
    rig.states.review(rig.graph, measured.stamp_ns)
    return outcome


def height_sigma_m(smoother):
    R = smoother.newest.nav.attitude().matrix()
    return np.sqrt((R @ smoother.newest.covariance[3:6, 3:6] @ R.T)[2, 2])


def test_a_measurement_that_agrees_enters_and_one_that_contradicts_does_not():
    rig, before = begun(until_s=3.0), begun()
    before.graph.main.node(ns(2.9))
    before.update()
    assert height_sigma_m(rig.graph.main) < 0.5 * height_sigma_m(before.graph.main)
    assert receive(rig, height(3.0, 1.0)) is Outcome.INNOVATION
    assert rig.events() == [(EventKind.REJECTED, "laser")]
    assert abs(rig.graph.main.newest.nav.position()[2] - DRIVE.nav(3.0).position()[2]) < 0.02


def test_a_sensor_that_keeps_contradicting_is_lost_by_name_and_regained_when_it_agrees_again():
    rig = begun(until_s=3.0)
    for t in np.arange(3.0, 3.5, 0.1):
        assert receive(rig, height(t, 1.0)) is Outcome.INNOVATION
    assert rig.states.lost() == ["laser"]
    (lost,) = [event for event in rig.log.take_events() if event.kind is EventKind.SENSOR_LOST]
    assert (lost.sensor, lost.reason) == ("laser", "5 innovation")
    waited = [receive(rig, height(t)) for t in np.arange(3.5, 5.6, 0.1)]
    assert set(waited) == {Outcome.QUARANTINED}
    assert rig.states.lost() == []
    (regained,) = rig.log.take_events()
    assert (regained.kind, regained.reason) == (EventKind.SENSOR_REGAINED, f"{len(waited)} good measurements in a row")
    assert rig.log.counts["laser", Outcome.QUARANTINED] == 0
    assert rig.log.counts["laser", Outcome.USED] == 29 + len(waited)
    assert receive(rig, height(5.6)) is Outcome.USED


def test_what_waited_enters_when_the_sensor_is_regained():
    rig = begun()
    receive(rig, height(0.1))
    rig.states.review(rig.graph, ns(2.0))  # silent
    assert rig.states.lost() == ["laser"]
    for t in np.arange(2.1, 2.5, 0.1):
        receive(rig, height(t))
    before = height_sigma_m(rig.graph.main)
    receive(rig, height(2.5))
    rig.update()
    assert height_sigma_m(rig.graph.main) < 0.7 * before


def test_they_enter_both_graphs_alike():
    rig = begun(until_s=2.0, graph={"fallback_odometry": "frozen"})
    rig.graph.lose()
    for t in np.arange(2.0, 7.0, 0.1):
        receive(rig, height(t))
    main, fallback = rig.graph.smoothers()
    assert main is not fallback
    assert height_sigma_m(main) < 0.01 and height_sigma_m(fallback) < 0.01


def test_a_measurement_that_left_the_window_is_late():
    rig = begun()
    for t in np.arange(0.1, 6.0, 0.5):
        rig.graph.main.node(ns(t))
        rig.update()
    assert receive(rig, height(0.5)) is Outcome.LATE


def test_measurements_with_correlated_errors_weigh_less_and_those_that_enter_at_once_share_it():
    sigmas = {}
    for correlation_s in (0.0, 10.0):
        rig = begun(LASER | {"correlation_s": correlation_s}, 3.0)
        sigmas[correlation_s] = height_sigma_m(rig.graph.main)
    assert sigmas[10.0] > 1.5 * sigmas[0.0]
    judged = JudgedSensor(rig.sensors["laser"], NoiseScale(), lambda _: None, rig.log)
    assert judged.held_inflation([]) == 1.0
    # three of one short time, the first after a long silence, weigh as much as one: a third each
    assert judged.held_inflation([height(t) for t in (1.0, 1.1, 1.2)]) == pytest.approx(3.0, rel=0.02)


@pytest.mark.parametrize("joint", [None, Joint(0.3, 0.1)])
def test_the_turn_joint_at_the_time_of_the_measurement_is_what_it_is_compared_with(joint):
    rig = Rig(DRIVE, machine(more={"wheels": WHEELS}), 3.0)
    asked, seen, sensor = [], [], rig.sensors["wheels"]

    class Watching:
        settings, parameters, name, factor, role = sensor.settings, (), "wheels", sensor.factor, sensor.role

        def first_parameter(self, *_):
            return np.zeros(0)

        def innovation(self, measured, state):
            seen.append(state.joint)
            return Outcome.NO_JOINT_ANGLE if state.joint is None else sensor.innovation(measured, state)

    judged = JudgedSensor(Watching(), NoiseScale(), lambda stamp_ns: asked.append(stamp_ns) or joint, rig.log)
    measured = rig.convert(twists(DRIVE, 0.5, 0.5)[0])
    outcome = judged.judge(measured, rig.graph.main, [rig.graph.main], measured.stamp_ns)
    assert outcome is (Outcome.NO_JOINT_ANGLE if joint is None else Outcome.USED)
    assert set(asked) == {measured.stamp_ns} and set(seen) == {joint}


def test_a_parameter_is_shared_by_all_measurements_of_a_sensor():
    rig = begun(LASER | {"offset_sigma_m": 100.0})
    for t in np.arange(0.1, 4.0, 0.1):
        fix = position(DRIVE, t, ARM)
        main = rig.graph.main
        main.enter(fix, rig.sensors["gnss"].factor([main.node(fix.stamp_ns)], fix, 1.0))
        assert receive(rig, height(t, 42.0)) is Outcome.USED
    (found,), (sigma,) = rig.graph.main.parameters.estimate("laser")
    assert abs(found - 42.0) < 4.0 * sigma < 0.02
