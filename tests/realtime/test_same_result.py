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
    """Play the messages through both and demand equal bits, health, counts and events."""
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
    return updates


@pytest.mark.parametrize("nodes", ["measurement", pytest.param("imu", marks=pytest.mark.slow)])
def test_every_estimate_and_state_is_the_same_through_a_loss_of_gnss(drive, nodes):
    updates = compare(with_settings(drive.config, graph={"nodes": nodes}), drive.until(16.0))
    assert updates > 240  # one per epoch at 20 Hz, and a lidar at 5 Hz, but for the loss and the start


def test_every_kind_of_sensor_gives_the_same(tmp_path):
    """Wheels on the chassis below the encoder, no slip, Doppler, a map matcher, a prism and a height beside GNSS."""
    machine = simulated(tmp_path, "new-sensors", duration_s=9.0, faults=[])
    kinds = {section.kind for section in machine.config.sensors.values()}
    assert {"twist", "nonholonomic", "gnss_velocity", "pose", "prism", "height", "joint"} <= kinds
    assert compare(machine.config, machine.messages) > 100


def test_a_clock_that_goes_back_starts_both_over_alike(drive):
    messages = drive.until(6.0) + shifted(drive.between(6.0, 10.0), -3_600_000_000_000)
    assert compare(drive.config, messages) > 100


@pytest.mark.parametrize("by_s", [1.0, -1.0, 50 * 365.25 * 86400.0])
def test_a_clock_that_steps_is_followed_alike(drive, by_s):
    stepped = [replace(m, stamp_ns=m.stamp_ns + round(by_s * 1e9)) for m in drive.between(6.0, 10.0)]
    assert compare(drive.config, drive.until(6.0) + stepped) > 150


def test_a_silence_of_an_hour_starts_both_over_alike(drive):
    assert compare(drive.config, drive.until(6.0) + shifted(drive.between(6.0, 10.0), 3_600_000_000_000)) > 100


def test_a_gap_and_a_straight_line_are_crossed_alike(drive):
    first_ns = drive.messages[0].stamp_ns
    messages = []
    for message in drive.until(8.0):
        second = (message.stamp_ns - first_ns) * 1e-9
        if isinstance(message, ImuSample) and message.sensor == "imu":
            if 4.0 < second < 5.0:
                continue
            if 6.0 < second < 6.3:  # what a logger draws over a drop-out
                flat = np.zeros(3), np.array([0.0, 0.0, 9.8])
                messages.append(ImuSample(message.stamp_ns, message.arrival_ns, "imu", *flat))
                continue
        messages.append(message)
    assert compare(drive.config, messages) > 100


def test_a_reset_and_a_new_datum_begin_anew_alike(drive):
    fix = next(m for m in drive.messages if isinstance(m, GnssFix))
    datum = Geodetic(fix.latitude_deg + 1e-3, fix.longitude_deg, fix.altitude_m)

    def meanwhile(estimator, number):
        if number == 1500:
            estimator.reset()
            assert not estimator.initialised
        if number == 2200:
            estimator.set_datum(datum)
            assert estimator.datum == datum

    compare(drive.config, drive.until(9.0), meanwhile)


def test_a_reset_starts_again_where_the_machine_stands(drive):
    estimator = Estimator(drive.config)
    before = [o.estimate for o in play(estimator, drive.until(1.8)) if o.estimate is not None][-1]
    estimator.reset()
    assert not estimator.initialised
    after = next(o.estimate for o in play(estimator, drive.between(1.8, 3.0)) if o.estimate is not None)
    # quick stands at first; both states rest on fixes of 1 cm
    assert np.linalg.norm(after.nav.position() - before.nav.position()) < 0.05
    assert estimator.event_counts["reset"] == 1
