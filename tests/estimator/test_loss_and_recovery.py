"""GNSS vanishes, is wrong and comes back: the fallback holds, O does not step, the world is right again."""

import itertools

import gtsam
import numpy as np
import pytest
from motion import (
    ARM,
    ARM_RIGHT,
    Drive,
    deviation,
    estimates,
    fix_at,
    fixes,
    imu,
    in_order,
    machine,
    ns,
    run,
    scans,
    seconds,
)

from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind, Health, Outcome
from holdfast.messages import Heading

OUTAGE = (8.0, 14.0)  # twice the lag
END_S = 18.0
PAPER = {
    "graph": {"main_odometry": "relative", "fallback_odometry": "frozen"},
    "frames": {"odometry_policy": "at_recovery"},
}


def recorded(seed=1, rng_scans=True, end_s=END_S, outage=OUTAGE, **how):
    rng = np.random.default_rng(seed)
    drive = Drive()
    antenna = fixes(drive, 0.0, end_s, 10.0, rng, phase_s=0.0137, **how)
    return drive, {
        "imu": imu(drive, 0.0, end_s, 100.0, rng),
        "gnss": [f for f in antenna if not ns(outage[0]) < f.stamp_ns < ns(outage[1])],
        "lidar": scans(drive, 0.0, end_s, 5.0, rng if rng_scans else None, phase_s=0.0071),
    }


def with_frames(sections):
    """The fixture's datum and the sections' frames."""
    config = machine(**{k: v for k, v in sections.items() if k != "frames"})
    return config.model_copy(update={"frames": config.frames.model_copy(update=sections.get("frames", {}))})


BOTH = pytest.mark.parametrize("sections", [{}, PAPER], ids=["default", "paper"])


def largest_step(outputs):
    """The largest difference between T_O_I as published and as the IMU carries it from the sample before [m], [rad]."""
    worst = np.zeros(2)
    for a, b in itertools.pairwise(estimates(outputs)):
        dt = (b.stamp_ns - a.stamp_ns) * 1e-9
        T_a, T_b = (e.T_W_O.inverse() * e.nav.pose() for e in (a, b))
        v = 0.5 * (a.T_W_O.rotation().unrotate(a.nav.velocity()) + b.T_W_O.rotation().unrotate(b.nav.velocity()))
        rotation = gtsam.Rot3.Expmap(0.5 * dt * (a.angular_velocity + b.angular_velocity))
        step = np.linalg.norm(T_b.translation() - T_a.translation() - v * dt)
        angle = np.linalg.norm(gtsam.Rot3.Logmap(rotation.between(T_a.rotation().between(T_b.rotation()))))
        worst = np.maximum(worst, [step, angle])
    return worst


@BOTH
def test_an_outage_twice_as_long_as_the_lag_is_crossed_and_reported(sections):
    drive, streams = recorded()
    estimator, outputs = run(with_frames(sections), in_order(*streams.values()))
    kinds = [e.kind for e in estimator.events if e.kind in (EventKind.GNSS_LOST, EventKind.GNSS_REGAINED)]
    assert kinds == [EventKind.GNSS_LOST, EventKind.GNSS_REGAINED]
    inside = [deviation(drive, e) for e in estimates(outputs) if ns(OUTAGE[0] + 1.0) < e.stamp_ns < ns(OUTAGE[1])]
    # three sigma of one scan, and the drift of six seconds at 1.5 m/s: 0.04 m per root metre
    assert max(position for position, _, _ in inside) < 3.0 * 0.02 + 3.0 * 0.04 * np.sqrt(9.0)
    after = [deviation(drive, e)[0] for e in estimates(outputs) if e.stamp_ns > ns(OUTAGE[1] + 2.0)]
    assert max(after) < 0.05  # five sigma of one fix


@BOTH
@pytest.mark.parametrize("seed", range(3))
def test_o_shows_no_step_at_loss_or_recovery(sections, seed):
    _, streams = recorded(seed)
    _, outputs = run(with_frames(sections), in_order(*streams.values()))
    position, rotation = largest_step(outputs)
    assert position < 0.002
    assert rotation < np.radians(0.02)


@pytest.mark.parametrize("offset_m", [0.5, 5.0, 300.0])
def test_false_fixes_at_the_recovery_never_enter(offset_m):
    drive, streams = recorded()
    false = [fix_at(drive, t, np.array([offset_m, -0.5 * offset_m, 0.2])) for t in OUTAGE[0] + np.arange(0.5, 5.0, 0.1)]
    estimator, outputs = run(machine(), in_order(*streams.values(), false))
    inside = [deviation(drive, e)[0] for e in estimates(outputs) if ns(OUTAGE[0]) < e.stamp_ns < ns(OUTAGE[1])]
    assert max(inside) < 0.3
    assert deviation(drive, estimates(outputs)[-1])[0] < 0.05
    assert estimator.counts["gnss", Outcome.INNOVATION] + estimator.counts["gnss", Outcome.TOO_FAST] >= 40


def test_fixes_that_were_used_just_before_a_fault_was_found_are_taken_out_again():
    drive, streams = recorded(outage=(50.0, 60.0))
    faulty = {k: f for k, f in enumerate(streams["gnss"]) if ns(9.0) < f.stamp_ns < ns(10.5)}
    for k, f in faulty.items():
        streams["gnss"][k] = fix_at(drive, seconds(f.stamp_ns), np.array([1.0, 1.0, 0.0]))
    estimator, outputs = run(machine(), in_order(*streams.values()))
    lost = next(e for e in estimator.events if e.kind is EventKind.GNSS_LOST)
    assert 9.0 < seconds(lost.stamp_ns) < 10.0
    assert estimator.counts["gnss", Outcome.QUARANTINED] >= 5
    assert max(deviation(drive, e)[0] for e in estimates(outputs) if e.stamp_ns > ns(6.0)) < 0.15


def test_every_fix_is_counted_under_exactly_one_outcome_over_loss_and_recovery():
    _, streams = recorded()
    estimator, _ = run(machine(), in_order(*streams.values()))
    counted = sum(n for (sensor, _), n in estimator.counts.items() if sensor == "gnss")
    waiting = estimator.waiting["gnss"]
    assert counted + waiting == len(streams["gnss"])


def two_antennas(seed=1, spoil=lambda fix: fix):
    rng = np.random.default_rng(seed)
    drive, streams = recorded(seed, outage=(50.0, 60.0))
    right = fixes(drive, 0.0, END_S, 10.0, rng, phase_s=0.0137, arm=ARM_RIGHT, sensor="gnss_right")
    return drive, streams | {"gnss_right": [spoil(f) for f in right]}


def test_one_faulty_antenna_is_lost_and_the_other_carries_on():
    drive, _ = two_antennas()

    def spoil(fix):
        t = seconds(fix.stamp_ns)
        if not 8.0 < t < 12.0:
            return fix
        apart_W = drive.nav(t).attitude().rotate(ARM_RIGHT - ARM)
        return fix_at(drive, t, 0.2 * apart_W, arm=ARM_RIGHT, sensor="gnss_right")

    drive, streams = two_antennas(spoil=spoil)
    estimator, outputs = run(machine(right=True, gate={"innovation": False}), in_order(*streams.values()))
    lost = [e.sensor for e in estimator.events if e.kind is EventKind.RECEIVER_LOST]
    assert lost == ["gnss_right"]
    assert not [e for e in estimator.events if e.kind is EventKind.GNSS_LOST]
    assert estimator.counts["gnss_right", Outcome.BASELINE] > 10
    assert max(deviation(drive, e)[0] for e in estimates(outputs) if e.stamp_ns > ns(6.0)) < 0.08


def test_headings_hold_the_yaw_while_the_machine_stands():
    """Standing, neither GNSS nor gravity observes the heading; the gyroscope drifts."""
    still = Drive(start_s=100.0)
    rng = np.random.default_rng(3)
    axis = still.nav(0.0).attitude().rotate(np.array([1.0, 0.0, 0.0]))
    yaw = float(np.arctan2(axis[1], axis[0]))
    headings = [
        Heading(ns(t), ns(t), "heading", yaw + float(rng.normal(0.0, 0.01)), 0.01) for t in np.arange(0.0, 30.0, 0.1)
    ]
    samples = imu(still, 0.0, 30.0, 100.0, rng)
    antenna = fixes(still, 0.0, 30.0, 5.0, rng)
    sigmas = {}
    for heading in (True, False):
        config = machine(lidar=False, heading=heading)
        estimator, outputs = run(config, in_order(samples, antenna, headings if heading else []))
        sigmas[heading] = np.sqrt(estimates(outputs)[-1].covariance[2, 2])
        if heading:
            assert estimator.counts["heading", Outcome.USED] > 250
    assert sigmas[True] < 0.5 * sigmas[False]


def test_a_heading_from_the_wrong_side_is_refused():
    drive, streams = recorded(outage=(50.0, 60.0))
    wrong = []
    for t in np.arange(6.0, END_S, 0.1):
        axis = drive.nav(t).attitude().rotate(np.array([1.0, 0.0, 0.0]))
        wrong.append(Heading(ns(t), ns(t), "heading", float(np.arctan2(-axis[1], -axis[0])), 0.01))
    known = machine(heading=True, heading_={"mounting_sigma_deg": 0.0})
    estimator, outputs = run(known, in_order(*streams.values(), wrong))
    assert estimator.counts["heading", Outcome.INNOVATION] == len(wrong)
    assert deviation(drive, estimates(outputs)[-1])[1] < np.radians(1.0)


def with_headings(yaw_offset_rad=lambda _: 0.0):
    """An outage without lidar under a gyroscope that may be 2 % off, and a heading ten times a second."""
    drive, streams = recorded()
    del streams["lidar"]
    headings = []
    for t in np.arange(0.05, END_S, 0.1):
        axis = drive.nav(t).attitude().rotate(np.array([1.0, 0.0, 0.0]))
        yaw = float(np.arctan2(axis[1], axis[0])) + yaw_offset_rad(t)
        headings.append(Heading(ns(t), ns(t), "heading", yaw, 0.005))
    return drive, streams | {"heading": headings}


UNSURE = {"lidar": False, "heading": True, "imu_": {"gyroscope_error_ratio": 0.02}}


def test_position_and_heading_of_a_recovery_are_corrected_in_one_step():
    drive, streams = with_headings()
    estimator, outputs = run(machine(**UNSURE), in_order(*streams.values()))
    (lost,) = [e.stamp_ns for e in estimator.events if e.kind is EventKind.GNSS_LOST]
    (regained,) = [e.stamp_ns for e in estimator.events if e.kind is EventKind.GNSS_REGAINED]
    before, after = estimates_around(outputs, regained)
    # 2 % of 1 rad/s, its sign kept for 1 s, over the 6 s of the outage; then over 0.4 s of headings
    assert np.sqrt(before.covariance[2, 2]) > 0.8 * 0.02 * np.sqrt(6.0)
    assert np.sqrt(after.covariance[2, 2]) < np.hypot(0.005, 0.02 * np.sqrt(0.4))
    assert deviation(drive, after)[0] < 0.05
    first_fix = min(f.stamp_ns for f in streams["gnss"] if f.stamp_ns > ns(OUTAGE[1]))
    alone = [h for h in streams["heading"] if lost < h.stamp_ns < first_fix]
    assert abs(estimator.counts["heading", Outcome.QUARANTINED] - len(alone)) <= 1  # one may come with the loss
    counted = sum(n for (sensor, _), n in estimator.counts.items() if sensor == "heading")
    waiting = estimator.waiting["heading"]
    assert counted + waiting == len(streams["heading"])


def test_a_heading_that_the_fixes_of_its_recovery_contradict_stays_out():
    drive, streams = with_headings(lambda t: 1.0 if OUTAGE[0] < t < OUTAGE[1] + 2.0 else 0.0)
    estimator, outputs = run(machine(**UNSURE), in_order(*streams.values()))
    (regained,) = [e.stamp_ns for e in estimator.events if e.kind is EventKind.GNSS_REGAINED]
    assert estimator.counts["heading", Outcome.INNOVATION] > 15
    _, after = estimates_around(outputs, regained)
    assert deviation(drive, after)[1] < 0.2


def estimates_around(outputs, stamp_ns):
    """The last estimate made before an update at a time, and the first one after it."""
    made = estimates(outputs)
    k = next(k for k, estimate in enumerate(made) if estimate.stamp_ns > stamp_ns)
    return made[k - 1], made[k]


def test_health_names_what_happens():
    _, streams = recorded()
    streams["lidar"] = [s for s in streams["lidar"] if not ns(15.0) < s.stamp_ns]
    estimator, seen = Estimator(machine()), {}
    for message in in_order(*streams.values()):
        estimator.process(message)
        seen.setdefault(estimator.health, seconds(message.arrival_ns))
    order = sorted(seen, key=lambda health: seen[health])
    assert order == [Health.INITIALISING, Health.NOMINAL, Health.FALLBACK, Health.RECOVERING, Health.ODOMETRY_LOST]
    assert OUTAGE[0] + 0.9 < seen[Health.FALLBACK] < OUTAGE[0] + 1.3
    assert OUTAGE[1] < seen[Health.RECOVERING] < OUTAGE[1] + 1.0
    report = estimator.health_report()
    assert "gnss" in report.fused and "lidar" not in report.fused
    assert report.ages_s["lidar"] > 2.0 > report.ages_s["gnss"]


def test_health_reports_an_imu_gap_and_an_optimiser_reset(monkeypatch):
    from holdfast.graph.smoother import OptimiserError, Smoother

    _, streams = recorded(outage=(50.0, 60.0))
    streams["imu"] = [s for s in streams["imu"] if not ns(9.0) < s.stamp_ns < ns(9.5)]
    estimator, seen, optimise = Estimator(machine()), set(), Smoother.optimise

    def failing(smoother):
        if ns(12.0) < smoother.newest_ns < ns(12.1):
            smoother._reanchor()
            raise OptimiserError("indeterminate system")
        return optimise(smoother)

    monkeypatch.setattr(Smoother, "optimise", failing)
    for message in in_order(*streams.values()):
        estimator.process(message)
        seen.add(estimator.health)
    assert {Health.IMU_GAP, Health.OPTIMISER_RESET, Health.NOMINAL} <= seen
