"""Data that cannot be: counted under its reason, and the estimator goes on and stays accurate."""

from dataclasses import replace

import numpy as np
import pytest
from motion import Drive, deviation, estimates, fixes, imu, in_order, machine, ns, run, scans

from holdfast.errors import ConfigError
from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind, Outcome
from holdfast.geometry.world import MOVED

FROM_1970_NS, FROM_2100_NS = 86_400_000_000_000, 4_102_444_800_000_000_000
END_S = 9.0
ACCURATE_M = 0.05  # five sigma of one fix


def recorded(seed=1):
    rng = np.random.default_rng(seed)
    drive = Drive()
    return drive, {
        "imu": imu(drive, 0.0, END_S, 100.0, rng),
        "gnss": fixes(drive, 0.0, END_S, 10.0, rng, phase_s=0.0137),
        "lidar": scans(drive, 0.0, END_S, 5.0, rng, phase_s=0.0071),
    }


def at(messages, t):
    return next(k for k, m in enumerate(messages) if m.stamp_ns >= ns(t))


def spoilt(message, name, value):
    array = getattr(message, name)
    if isinstance(array, float):
        return replace(message, **{name: value})
    broken = array.copy()
    broken[0] = value
    return replace(message, **{name: broken})


def survives(streams, drive):
    """Run to the end; it must be alive and accurate there."""
    estimator, outputs = run(machine(), in_order(*streams.values()))
    given = estimates(outputs)
    assert given[-1].stamp_ns == streams["imu"][-1].stamp_ns
    assert all(np.isfinite(e.covariance).all() and np.isfinite(e.nav.matrix()).all() for e in given)
    late = [deviation(drive, e)[0] for e in given if e.stamp_ns > ns(END_S - 1.0)]
    assert len(late) > 90 and max(late) < ACCURATE_M
    return estimator


@pytest.mark.parametrize(
    ("sensor", "field", "value", "outcome"),
    [
        ("imu", "specific_force", np.nan, Outcome.NOT_FINITE),
        ("imu", "angular_velocity", np.inf, Outcome.NOT_FINITE),
        ("imu", "specific_force", 1e300, Outcome.OUT_OF_RANGE),
        ("imu", "angular_velocity", -1e4, Outcome.OUT_OF_RANGE),
        ("gnss", "latitude_deg", np.nan, Outcome.NOT_FINITE),
        ("gnss", "altitude_m", np.inf, Outcome.NOT_FINITE),
        ("gnss", "latitude_deg", 1e300, Outcome.OUT_OF_RANGE),
        ("gnss", "longitude_deg", -1e300, Outcome.OUT_OF_RANGE),
        ("gnss", "latitude_deg", -47.0, Outcome.TOO_FAST),
        ("lidar", "position", np.nan, Outcome.NOT_FINITE),
        ("lidar", "quaternion", np.inf, Outcome.NOT_FINITE),
    ],
)
def test_a_measurement_that_cannot_be_is_counted_and_survived(sensor, field, value, outcome):
    drive, streams = recorded()
    for t in (5.0, 5.5, 6.0):
        k = at(streams[sensor], t)
        streams[sensor][k] = spoilt(streams[sensor][k], field, value)
    estimator = survives(streams, drive)
    assert estimator.counts[sensor, outcome] == 3
    if sensor != "imu":
        # one good fix in a thousand is beyond the gate, and then contradicted by its successors
        reported = [e.reason for e in estimator.events if e.kind is EventKind.REJECTED and e.sensor == sensor]
        assert [reason for reason in reported if reason != Outcome.CONTRADICTED] == [outcome] * 3
        assert estimator.counts[sensor, Outcome.CONTRADICTED] <= 1


def test_an_absurd_altitude_is_out_of_range():
    drive, streams = recorded()
    for k in range(at(streams["gnss"], 5.0), at(streams["gnss"], 6.0)):
        streams["gnss"][k] = replace(streams["gnss"][k], altitude_m=1e300)
    assert survives(streams, drive).counts["gnss", Outcome.OUT_OF_RANGE] == 10


def test_a_first_fix_with_an_absurd_altitude_does_not_become_the_datum():
    _drive, streams = recorded()
    config = machine(frames={"datum": None})
    streams["gnss"][0] = replace(streams["gnss"][0], altitude_m=1e300)
    estimator, outputs = run(config, in_order(*streams.values()))
    assert estimator.datum is not None and abs(estimator.datum.altitude_m) < 1e4
    assert estimates(outputs)


def test_first_fixes_far_off_do_not_stay_the_datum():
    """A hundred kilometres, where up is a degree off."""
    _drive, streams = recorded()
    config = machine(frames={"datum": None})
    true = streams["gnss"][0]
    for k in range(2):
        fix = streams["gnss"][k]
        streams["gnss"][k] = replace(fix, latitude_deg=fix.latitude_deg + 0.9)
    estimator, outputs = run(config, in_order(*streams.values()))
    assert abs(estimator.datum.latitude_deg - true.latitude_deg) < 1e-3
    (told,) = [event for event in estimator.events if event.kind is EventKind.RESET]
    assert told.reason == MOVED and told.sensor == "gnss"
    assert EventKind.NOISE not in {event.kind for event in estimator.events}
    assert estimates(outputs)


def test_zeros_of_a_receiver_without_a_position_are_no_fix():
    _drive, streams = recorded()
    config = machine(frames={"datum": None})
    for k in range(20):
        streams["gnss"][k] = replace(streams["gnss"][k], latitude_deg=0.0, longitude_deg=0.0, altitude_m=0.0)
    estimator, outputs = run(config, in_order(*streams.values()))
    assert estimator.counts["gnss", Outcome.LOW_STATUS] == 20
    assert estimator.datum.latitude_deg > 1.0 and estimates(outputs)


@pytest.mark.parametrize("value", [1e3, 1e9, 1e300])
def test_a_lidar_that_jumps_is_survived(value):
    drive, streams = recorded()
    k = at(streams["lidar"], 5.0)
    streams["lidar"][k] = spoilt(streams["lidar"][k], "position", value)
    survives(streams, drive)


def test_a_covariance_of_absurd_size_is_survived():
    drive, streams = recorded()
    k = at(streams["gnss"], 5.0)
    fix = streams["gnss"][k]
    streams["gnss"][k] = replace(fix, covariance=np.diag([1e-4, 1e-4, 1e300]))
    streams["gnss"][k + 1] = replace(streams["gnss"][k + 1], covariance=np.full((3, 3), 1e-4))
    streams["gnss"][k + 2] = replace(
        streams["gnss"][k + 2], covariance=np.array([[1e-4, 9, 0], [9, 1e-4, 0], [0, 0, 1]])
    )
    estimator = survives(streams, drive)
    assert estimator.counts["gnss", Outcome.USED] > 60


@pytest.mark.parametrize(
    ("stamp_ns", "outcome"), [(FROM_1970_NS, Outcome.BACKWARD), (FROM_2100_NS, Outcome.CLOCK_JUMP)]
)
def test_imu_samples_from_another_century_are_counted_and_survived(stamp_ns, outcome):
    drive, streams = recorded()
    k = at(streams["imu"], 5.0)
    streams["imu"][k] = replace(streams["imu"][k], stamp_ns=stamp_ns)
    estimator = survives(streams, drive)
    assert estimator.counts["imu", outcome] == 1


@pytest.mark.parametrize("ahead_s", [10.0, 59.0])
def test_one_imu_sample_from_the_future_does_not_poison_the_rest(ahead_s):
    drive, streams = recorded()
    k = at(streams["imu"], 5.0)
    streams["imu"][k] = replace(streams["imu"][k], stamp_ns=streams["imu"][k].stamp_ns + round(ahead_s * 1e9))
    survives(streams, drive)


def test_a_first_imu_sample_from_the_future_does_not_poison_the_rest():
    drive, streams = recorded()
    streams["imu"][0] = replace(streams["imu"][0], stamp_ns=FROM_2100_NS)
    survives(streams, drive)


@pytest.mark.parametrize("sensor", ["gnss", "lidar"])
def test_a_measurement_from_1970_is_late(sensor):
    drive, streams = recorded()
    k = at(streams[sensor], 5.0)
    streams[sensor][k] = replace(streams[sensor][k], stamp_ns=FROM_1970_NS)
    assert survives(streams, drive).counts[sensor, Outcome.LATE] == 1


@pytest.mark.parametrize("sensor", ["gnss", "lidar"])
def test_a_measurement_from_2100_is_counted(sensor):
    drive, streams = recorded()
    k = at(streams[sensor], 5.0)
    streams[sensor][k] = replace(streams[sensor][k], stamp_ns=FROM_2100_NS)
    estimator = survives(streams, drive)
    waiting = estimator.waiting[sensor]
    assert sum(n for (name, _), n in estimator.counts.items() if name == sensor) + waiting == len(streams[sensor])
    assert estimator.counts[sensor, Outcome.CLOCK_JUMP] == 1


def test_a_fix_from_the_future_does_not_lead_the_state_away_while_the_imu_is_silent():
    drive, streams = recorded()
    streams["imu"] = [s for s in streams["imu"] if not ns(5.0) < s.stamp_ns < ns(5.6)]
    k = at(streams["gnss"], 5.4)
    streams["gnss"][k] = replace(streams["gnss"][k], stamp_ns=streams["gnss"][k].stamp_ns + 3_600_000_000_000)
    survives(streams, drive)


@pytest.mark.parametrize("sensor", ["gnss", "lidar"])
def test_a_measurement_from_2100_does_not_keep_others_waiting(sensor):
    drive, streams = recorded()
    k = at(streams[sensor], 5.0)
    streams[sensor].insert(k, replace(streams[sensor][k], stamp_ns=FROM_2100_NS))
    estimator = survives(streams, drive)
    clean, _ = run(machine(), in_order(*recorded()[1].values()))
    assert estimator.counts[sensor, Outcome.USED] == clean.counts[sensor, Outcome.USED]


def test_an_imu_sample_that_comes_twice_changes_nothing():
    _drive, streams = recorded()
    clean = estimates(run(machine(), in_order(*streams.values()))[1])
    twice = [copy for s in streams["imu"] for copy in (s, s)]
    estimator, outputs = run(machine(), in_order(twice, streams["gnss"], streams["lidar"]))
    assert estimator.counts["imu", Outcome.DUPLICATE] == len(streams["imu"])
    for a, b in zip(clean, estimates(outputs), strict=True):
        assert (a.nav.matrix() == b.nav.matrix()).all()


@pytest.mark.parametrize("sensor", ["gnss", "lidar"])
def test_a_measurement_that_comes_twice_is_used_once(sensor):
    _drive, streams = recorded()
    clean = run(machine(), in_order(*streams.values()))[1]
    plain = estimates(clean)[-1]
    streams[sensor] = [copy for m in streams[sensor] for copy in (m, replace(m, arrival_ns=m.arrival_ns + 1_000_000))]
    estimator, outputs = run(machine(), in_order(*streams.values()))
    assert estimator.counts[sensor, Outcome.DUPLICATE] > 30
    again = estimates(outputs)[-1]
    assert np.trace(again.covariance) == pytest.approx(np.trace(plain.covariance), rel=0.01)


def test_scans_in_the_wrong_order_are_survived():
    drive, streams = recorded()
    k = at(streams["lidar"], 5.0)
    streams["lidar"][k] = replace(streams["lidar"][k], arrival_ns=streams["lidar"][k].arrival_ns + 300_000_000)
    estimator = survives(streams, drive)
    total = sum(n for (name, _), n in estimator.counts.items() if name == "lidar")
    assert total + estimator.waiting["lidar"] == len(streams["lidar"])


def test_every_measurement_is_counted_under_exactly_one_outcome():
    drive, streams = recorded()
    estimator = survives(streams, drive)
    for sensor, messages in streams.items():
        counted = sum(n for (name, _), n in estimator.counts.items() if name == sensor)
        assert counted + estimator.waiting[sensor] == len(messages)


def test_what_waits_for_the_imu_at_the_end_is_counted():
    drive, streams = recorded()
    last = streams["imu"][-1].stamp_ns
    late = [replace(m, stamp_ns=last + 10_000_000 + n, arrival_ns=last) for n, m in enumerate(streams["lidar"][-2:])]
    estimator = survives(streams, drive)
    waiting = estimator.waiting["lidar"]
    for message in late:
        estimator.process(message)
    estimator.keep_records()
    before = [estimator.counts["lidar", outcome] for outcome in Outcome if outcome is not Outcome.UNREACHED]
    assert estimator.counts["lidar", Outcome.UNREACHED] == 0
    for _ in range(2):
        estimator.close()
        assert estimator.counts["lidar", Outcome.UNREACHED] == waiting + 2
    assert [estimator.counts["lidar", outcome] for outcome in Outcome if outcome is not Outcome.UNREACHED] == before
    assert [one.stamp_ns for one in estimator.take_records() if one.sensor == "lidar"][-2:] == [
        message.stamp_ns for message in late
    ]
    assert estimator.waiting.total() == 0


@pytest.mark.parametrize("off_m", [20.0, 100.0, 1e6])
def test_six_fixes_that_are_far_off_do_harm_for_a_while_only(off_m):
    drive, streams = recorded()
    k = at(streams["gnss"], 4.0)
    for j in range(k, k + 6):
        streams["gnss"][j] = replace(streams["gnss"][j], altitude_m=streams["gnss"][j].altitude_m + off_m)
    _, outputs = run(machine(), in_order(*streams.values()))
    given = estimates(outputs)
    position, rotation, _ = deviation(drive, given[-1])  # 40 good fixes later
    assert position < 0.1
    assert rotation < np.radians(5.0)


@pytest.mark.parametrize("kind", ["imu", "gnss", "lidar"])
def test_before_the_start_absurd_data_do_not_stop_it(kind):
    drive, streams = recorded()
    fields = {"imu": ("specific_force", np.nan), "gnss": ("latitude_deg", np.nan), "lidar": ("position", np.inf)}
    for k in range(5):
        streams[kind][k] = spoilt(streams[kind][k], *fields[kind])
    survives(streams, drive)


def test_no_message_at_all_leaves_an_estimator_that_reports_what_it_waits_for():
    estimator = Estimator(machine())
    assert (
        not estimator.initialised
        and estimator.waiting_for == "no usable IMU sample has come, and no usable position has come"
    )


def test_a_message_of_a_sensor_that_is_not_configured_is_refused_by_its_name():
    estimator = Estimator(machine())
    stranger = replace(next(iter(fixes(Drive(), 0.0, 1.0))), sensor="third")
    with pytest.raises(ConfigError, match=r"sensors\.third: not in the configuration"):
        estimator.process(stranger)


@pytest.mark.parametrize("name", ["gnss", "lidar"])
def test_a_flood_is_thinned_out_and_the_window_stays_small(name):
    drive, streams = recorded()
    make = {"gnss": fixes, "lidar": scans}[name]
    flood = make(drive, 4.0, 5.0, 4000.0, np.random.default_rng(2))
    streams[name] = sorted([*streams[name], *flood], key=lambda message: message.stamp_ns)
    estimator = survives(streams, drive)
    assert 3700 < estimator.counts[name, Outcome.OVERLOAD] < 3850  # 200 a second are taken in
    assert estimator.event_counts[EventKind.OVERLOAD] <= 2
