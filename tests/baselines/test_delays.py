"""What arrives late is taken in at its own time, so that the result does not depend on when it arrived."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import GnssFix, SensorPose, later, outputs_of

from holdfast.baselines.msf import make_msf
from holdfast.baselines.tsif import make_tsif
from holdfast.events import EventKind, Outcome


def last(localiser, messages):
    """Return the state after the newest measurement, from a stream that ends with a second of the IMU alone."""
    end = max(message.stamp_ns for message in messages)
    kept = [m for m in messages if m.stamp_ns < end - 1_500_000_000 or not isinstance(m, (GnssFix, SensorPose))]
    return outputs_of(localiser, kept)[1][-1]


@pytest.mark.parametrize("make", [make_msf, make_tsif])
@pytest.mark.parametrize("kinds", [GnssFix, SensorPose, (GnssFix, SensorPose)])
def test_a_delayed_measurement_does_what_a_punctual_one_does(open_drive, make, kinds):
    first = open_drive.messages[0].arrival_ns
    started = [m for m in open_drive.messages if m.arrival_ns < first + 3_000_000_000]
    rest = later(open_drive.messages[len(started) :], kinds, 400_000_000)
    punctual = last(make(open_drive.config), open_drive.messages)
    delayed = last(make(open_drive.config), started + rest)
    assert delayed.stamp_ns == punctual.stamp_ns
    np.testing.assert_allclose(delayed.nav.position(), punctual.nav.position(), atol=1e-9)
    np.testing.assert_allclose(delayed.nav.attitude().matrix(), punctual.nav.attitude().matrix(), atol=1e-9)
    np.testing.assert_allclose(delayed.covariance, punctual.covariance, rtol=1e-5, atol=1e-12)


def test_a_measurement_older_than_the_buffer_is_counted_and_reported(open_drive):
    localiser = make_msf(open_drive.config)
    first = open_drive.messages[0].arrival_ns
    started = [m for m in open_drive.messages if m.arrival_ns < first + 8_000_000_000]
    outputs_of(localiser, started)
    localiser.take_events()
    old = next(m for m in started if isinstance(m, GnssFix) and m.stamp_ns > first + 3_000_000_000)
    late = replace(old, stamp_ns=old.stamp_ns + 1)  # no duplicate
    before = localiser.counts[late.sensor, Outcome.LATE]
    localiser.process(late)
    assert localiser.counts[late.sensor, Outcome.LATE] == before + 1
    assert [event.kind for event in localiser.take_events()] == [EventKind.LATE]


@pytest.mark.parametrize("make", [make_msf, make_tsif])
def test_every_measurement_is_counted_once(drive, make):
    localiser = make(drive.config)
    outputs_of(localiser, drive.messages)
    for sensor in ("imu", "gnss", "gnss_right", "lidar", "heading"):
        counted = sum(count for (name, _), count in localiser.counts.items() if name == sensor)
        # the very last may still wait for the IMU
        assert 0 <= sum(m.sensor == sensor for m in drive.messages) - counted <= 2, sensor
