"""With equal trigger points the engine gives what the estimator in one process gives, to the bit."""

from dataclasses import replace

import numpy as np
import pytest
from engine import bits, events_of, play, shifted, simulated, with_settings

from holdfast.estimator.estimator import Estimator
from holdfast.geometry.earth import Geodetic
from holdfast.messages import GnssFix, ImuSample
from holdfast.realtime.engine import RealtimeEstimator


def compare(config, messages, meanwhile=None):
    """Play the messages through both and demand equal bits, health, counts and events.

    Return the estimator in one process and how often it updated.
    """
    inline = Estimator(config)
    updates = 0
    with RealtimeEstimator(config, in_step=True) as engine:
        for number, message in enumerate(messages):
            if meanwhile is not None:
                meanwhile(inline, number)
                meanwhile(engine, number)
            ours, other = engine.process(message), inline.process(message)
            assert bits(ours) == bits(other), f"message {number}, {type(message).__name__} {message.stamp_ns}"
            assert engine.health is inline.health
            assert engine.initialised is inline.initialised
            updates += other.optimised is not None
        assert engine.datum == inline.datum
        assert engine.waiting_for == inline.waiting_for
        assert engine.health_report() == inline.health_report()
    inline.close()
    assert engine.counts == inline.counts
    assert engine.event_counts == inline.event_counts
    assert events_of(engine) == events_of(inline)
    return inline, updates


@pytest.fixture(scope="module")
def losing(tmp_path_factory):
    """A drive on which GNSS is lost for three seconds and comes back."""
    outage = {"kind": "outage", "sensors": ["gnss", "gnss_right", "heading"], "start_s": 5.0, "end_s": 8.0}
    return simulated(tmp_path_factory.mktemp("losing"), duration_s=9.0, faults=[outage])


@pytest.mark.parametrize("nodes", ["measurement", pytest.param("imu", marks=pytest.mark.slow)])
def test_every_estimate_and_state_is_the_same_through_a_loss_of_gnss(losing, nodes):
    inline, updates = compare(with_settings(losing.config, graph={"nodes": nodes}), losing.messages)
    assert updates > 100  # one per epoch at 20 Hz, and a lidar at 5 Hz, but for the loss and the start
    assert inline.event_counts["gnss_lost"] == inline.event_counts["gnss_regained"] == 1


def test_every_kind_of_sensor_gives_the_same(tmp_path):
    """Wheels on the chassis below the encoder, no slip, Doppler, a map matcher, a prism and a height beside GNSS."""
    machine = simulated(tmp_path, "new-sensors", duration_s=6.0, faults=[])
    kinds = {section.kind for section in machine.config.sensors.values()}
    assert {"twist", "nonholonomic", "gnss_velocity", "pose", "prism", "height", "joint"} <= kinds
    _, updates = compare(machine.config, machine.messages)
    assert updates > 100


def test_a_clock_that_goes_back_starts_both_over_alike(drive):
    messages = drive.until(4.0) + shifted(drive.between(4.0, 6.5), -3_600_000_000_000)
    inline, updates = compare(drive.config, messages)
    assert updates > 70 and inline.event_counts["initialised"] == 2


@pytest.mark.parametrize("by_s", [1.0, -1.0, 50 * 365.25 * 86400.0])
def test_a_clock_that_steps_is_followed_alike(drive, by_s):
    stepped = [replace(m, stamp_ns=m.stamp_ns + round(by_s * 1e9)) for m in drive.between(4.0, 6.5)]
    inline, updates = compare(drive.config, drive.until(4.0) + stepped)
    assert updates > 110 and inline.event_counts["initialised"] == inline.event_counts["clock_step"] == 1


def test_a_silence_of_an_hour_starts_both_over_alike(drive):
    inline, updates = compare(drive.config, drive.until(4.0) + shifted(drive.between(4.0, 6.5), 3_600_000_000_000))
    assert updates > 70 and inline.event_counts["initialised"] == 2


def test_a_gap_and_a_straight_line_are_crossed_alike(drive):
    first_ns = drive.messages[0].stamp_ns
    messages = []
    for message in drive.until(6.5):
        second = (message.stamp_ns - first_ns) * 1e-9
        if isinstance(message, ImuSample) and message.sensor == "imu":
            if 3.5 < second < 4.5:
                continue
            if 5.5 < second < 5.8:  # what a logger draws over a drop-out
                flat = np.zeros(3), np.array([0.0, 0.0, 9.8])
                messages.append(ImuSample(message.stamp_ns, message.arrival_ns, "imu", *flat))
                continue
        messages.append(message)
    inline, updates = compare(drive.config, messages)
    assert updates > 100 and inline.event_counts["imu_gap"] == 1


def test_a_reset_and_a_new_datum_begin_anew_alike(drive):
    fix = next(m for m in drive.messages if isinstance(m, GnssFix))
    datum = Geodetic(fix.latitude_deg + 1e-3, fix.longitude_deg, fix.altitude_m)

    def meanwhile(estimator, number):
        if number == 800:
            estimator.reset()
            assert not estimator.initialised
        if number == 1600:
            estimator.set_datum(datum)
            assert estimator.datum == datum

    inline, _ = compare(drive.config, drive.until(7.0), meanwhile)
    assert inline.event_counts["reset"] == 2 and inline.event_counts["initialised"] == 3


def test_a_reset_starts_again_where_the_machine_stands(drive):
    estimator = Estimator(drive.config)
    before = [o.estimate for o in play(estimator, drive.until(1.8)) if o.estimate is not None][-1]
    estimator.reset()
    assert not estimator.initialised
    after = next(o.estimate for o in play(estimator, drive.between(1.8, 3.0)) if o.estimate is not None)
    # quick stands at first; both states rest on fixes of 1 cm
    assert np.linalg.norm(after.nav.position() - before.nav.position()) < 0.05
    assert estimator.event_counts["reset"] == 1
