"""Asynchronous and delayed data: each measurement goes to its own time, in whatever order it comes."""

from dataclasses import replace

import numpy as np
import pytest
from faults import late
from motion import Drive, apart, deviation, estimates, fix_at, fixes, imu, in_order, machine, ns, run, scans, seconds

from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind, Outcome
from holdfast.graph.nodes import NODE_RESOLUTION_NS

END_S = 9.0
PATIENT = {"silence_s": 20.0}  # whether a receiver was silent does depend on when its fixes came
SLOW_IMU = pytest.param("imu", marks=pytest.mark.slow)  # seven times as many nodes
POLICIES = pytest.mark.parametrize("nodes", ["measurement", "imu"])
FIRST_POLICY = pytest.mark.parametrize("nodes", ["measurement", SLOW_IMU])


def recorded(seed=1, end_s=END_S, hz=100.0):
    rng = np.random.default_rng(seed)
    drive = Drive()
    return (
        drive,
        imu(drive, 0.0, end_s + 0.5, hz, rng),
        fixes(drive, 0.0, end_s, 10.0, rng, phase_s=0.0137),
        scans(drive, 0.0, end_s, 5.0, rng, phase_s=0.0071),
    )


def newest(config, messages):
    """The newest node after all messages, once more optimised."""
    estimator, outputs = run(config, messages)
    return estimator, [o.optimised for o in outputs if o.optimised is not None][-1]


def shuffled(seed, gnss_s, lidar_s, end_s=END_S, hz=100.0):
    """The same data, with GNSS and lidar late by constant but different times; starting is left alone."""
    drive, samples, antenna, lidar = recorded(end_s=end_s, hz=hz)
    rng = np.random.default_rng(seed)

    def delayed(messages, delay_s):
        begin = [m for m in messages if m.stamp_ns < ns(2.4)]
        rest = [m for m in messages if m.stamp_ns >= ns(2.4)]
        jitter = np.sort(rng.uniform(0.0, 0.02, len(rest)))
        return begin + late(rest, delay_s + jitter)

    tail = imu(drive, end_s + 0.5 + 1.0 / hz, end_s + 2.0, hz, np.random.default_rng(99))
    last = fix_at(drive, end_s + 1.9531, np.zeros(3))  # the same newest node, whatever came before
    return in_order(samples + tail, delayed(antenna, gnss_s), delayed(lidar, lidar_s), [last])


def largest_difference(config, end_s=END_S, hz=100.0):
    """The largest difference in position [m] and rotation [rad] between four orders of arrival."""
    states = []
    for seed, delays in enumerate([(0.0, 0.0), (0.3, 0.05), (0.05, 0.3), (1.5, 0.02)]):
        estimator, state = newest(config, shuffled(seed, *delays, end_s=end_s, hz=hz))
        assert estimator.counts["gnss", Outcome.LATE] == estimator.counts["lidar", Outcome.LATE] == 0
        assert estimator.counts["gnss", Outcome.INNOVATION] == 0
        states.append(state)
    assert len({state.stamp_ns for state in states}) == 1
    return np.max([apart(states[0].nav, state.nav) for state in states[1:]], axis=0)


@FIRST_POLICY
def test_the_order_in_which_two_sensors_arrive_changes_the_result_by_less_than_a_tenth_of_a_fix(nodes):
    """The nodes are the same; linearisation points, marginalisation and motion noise come from the estimate of then."""
    config = machine(graph={"nodes": nodes, "lag_s": 3.0}, gate=PATIENT)
    position, rotation, _ = largest_difference(config, hz=50.0 if nodes == "imu" else 100.0)
    assert position < 1e-3  # fixes have a sigma of 1 cm
    assert rotation < 1e-3


@FIRST_POLICY
def test_the_order_of_arrival_matters_little_to_a_window_that_holds_and_relinearises_all(nodes):
    """What is left is rounding: a node per sample is stiff, its positions are tied to a tenth of a millimetre."""
    graph = {"nodes": nodes, "lag_s": 60.0, "relinearize_threshold_rad": 1e-9}
    config = machine(graph=graph, standstill={"enabled": False}, gate=PATIENT)
    # each update costs what all of the drive does
    position, rotation, _ = largest_difference(config, end_s=5.0, hz=50.0 if nodes == "imu" else 100.0)
    assert position < 1e-4  # a hundredth of a fix
    assert rotation < 1e-4


@POLICIES
def test_a_measurement_between_two_nodes_leaves_less_than_a_millimetre(nodes):
    """Clean sensors at times that fit neither the IMU nor the grid, at 1.5 m/s and 1 rad/s."""
    drive = Drive()
    messages = in_order(
        imu(drive, 0.0, END_S, 200.0, phase_s=0.00123),
        fixes(drive, 0.0, END_S, 10.0, phase_s=0.013713),
        scans(drive, 0.0, END_S, 5.0, phase_s=0.007146),
    )
    _estimator, outputs = run(machine(graph={"nodes": nodes}), messages)
    states = [o.optimised for o in outputs if o.optimised is not None and o.optimised.stamp_ns > ns(5.0)]
    assert len(states) > 30
    errors = np.array([deviation(drive, state) for state in states])
    assert np.median(errors[:, 0]) < 1e-3 and np.median(errors[:, 1]) < np.radians(0.01)
    assert errors[:, 0].max() < 1e-3
    assert errors[:, 1].max() < np.radians(0.01)


@POLICIES
def test_a_node_lies_within_a_twentieth_of_a_millisecond_of_its_measurement(nodes):
    _, samples, antenna, lidar = recorded()
    _, outputs = run(machine(graph={"nodes": nodes}), in_order(samples, antenna, lidar))
    stamps = node_stamps(outputs)
    # those with which it started have none
    inside = [m.stamp_ns for m in antenna + lidar if stamps[0] + 100_000_000 < m.stamp_ns < stamps[-1]]
    assert len(inside) > 30
    nearest = [abs(stamps - stamp).min() for stamp in inside]
    assert max(nearest) <= NODE_RESOLUTION_NS // 2 < 100_000


@FIRST_POLICY
def test_the_same_messages_twice_give_the_same_bits(nodes):
    _, samples, antenna, lidar = recorded()
    messages = in_order(samples, late(antenna, np.full(len(antenna), 0.12)), lidar)
    broken = replace(antenna[40], altitude_m=antenna[40].altitude_m + 30.0)
    messages.insert(len(messages) // 2, broken)
    first, second = (run(machine(graph={"nodes": nodes}), messages) for _ in range(2))
    assert first[0].events == second[0].events and len(first[0].events) > 0
    assert first[0].counts == second[0].counts
    ours, theirs = estimates(first[1]), estimates(second[1])
    assert len(ours) == len(theirs) > 500
    for a, b in zip(ours, theirs, strict=True):
        assert a.stamp_ns == b.stamp_ns
        assert (a.nav.matrix() == b.nav.matrix()).all()
        assert (a.covariance == b.covariance).all()
        assert (a.bias.vector() == b.bias.vector()).all()
        assert (a.T_W_O.matrix() == b.T_W_O.matrix()).all()


def test_a_measurement_waits_until_the_imu_reaches_its_time():
    drive, samples, antenna, _ = recorded()
    estimator, _ = run(machine(lidar=False), in_order(samples[:500], [f for f in antenna if f.stamp_ns < ns(4.9)]))
    before = estimator.counts["gnss", Outcome.USED]
    early = replace(fix_at(drive, 5.033), arrival_ns=samples[500].arrival_ns)
    assert estimator.process(early).optimised is None
    for sample in samples[500:504]:  # up to 5.03 s
        assert estimator.process(sample).optimised is None
    output = estimator.process(samples[504])
    assert output.optimised is not None and abs(output.optimised.stamp_ns - ns(5.033)) <= 50_000
    assert output.estimate is not None and output.estimate.stamp_ns == samples[504].stamp_ns
    assert estimator.counts["gnss", Outcome.USED] == before + 1


@pytest.mark.parametrize("sensor", ["gnss", "lidar"])
def test_what_is_later_than_the_lag_is_counted_and_reported_and_changes_nothing(sensor):
    _drive, samples, antenna, lidar = recorded()
    messages = in_order(samples, antenna, lidar)
    estimator, _ = run(machine(), messages)
    old = {"gnss": antenna, "lidar": lidar}[sensor][(30 if sensor == "gnss" else 15)]
    old = replace(old, stamp_ns=old.stamp_ns + 1, arrival_ns=messages[-1].arrival_ns)  # no duplicate
    output = estimator.process(old)
    assert output == type(output)()
    assert estimator.counts[sensor, Outcome.LATE] == 1
    event = estimator.events[-1]
    assert (event.kind, event.sensor, event.stamp_ns) == (EventKind.LATE, sensor, old.stamp_ns)
    assert "behind the newest state" in event.reason


def test_delays_up_to_the_lag_are_used():
    _drive, samples, antenna, lidar = recorded()
    moving = [f for f in antenna if f.stamp_ns > ns(4.0)]
    start = [f for f in antenna if f.stamp_ns <= ns(4.0)]
    estimator, _outputs = run(
        machine(graph={"lag_s": 3.0}), in_order(samples, start, late(moving, np.full(len(moving), 2.8)), lidar)
    )
    assert estimator.counts["gnss", Outcome.LATE] == 0
    arrived = sum(f.stamp_ns + 2_800_000_000 <= samples[-1].stamp_ns for f in moving)
    assert arrived > 20 and estimator.counts["gnss", Outcome.USED] >= arrived


@pytest.mark.parametrize("sensor", ["imu", "gnss"])
def test_a_slow_clock_costs_accuracy_unless_its_offset_is_given(sensor):
    """80 ms are 12 cm at 1.5 m/s; corrected, the error stays below three sigma of one fix."""
    drive, samples, antenna, lidar = recorded()
    streams = {"imu": samples, "gnss": antenna, "lidar": lidar}
    streams[sensor] = [replace(m, stamp_ns=m.stamp_ns - 80_000_000) for m in streams[sensor]]
    worst = {}
    for given in (0.08, 0.0):
        clock = {"time_offset_s": given, **({} if sensor == "imu" else {"time_offset_sigma_s": 0.0})}
        _, outputs = run(machine(**{f"{sensor}_": clock}), in_order(*streams.values()))
        worst[given] = np.mean([deviation(drive, e)[0] for e in estimates(outputs) if e.stamp_ns > ns(5.5)])
    assert worst[0.08] < 0.03
    assert worst[0.0] > 2.0 * worst[0.08]


@pytest.mark.parametrize("sensor", ["imu", "gnss", "lidar"])
def test_a_corrected_clock_gives_exactly_what_the_true_clock_gives(sensor):
    _, samples, antenna, lidar = recorded(end_s=6.0)
    streams = {"imu": samples, "gnss": antenna, "lidar": lidar}
    plain = run(machine(), in_order(*streams.values()))[1]
    streams[sensor] = [replace(m, stamp_ns=m.stamp_ns + 40_000_000) for m in streams[sensor]]
    moved = run(machine(**{f"{sensor}_": {"time_offset_s": -0.04}}), in_order(*streams.values()))[1]
    assert len(estimates(plain)) > 300
    for a, b in zip(estimates(plain), estimates(moved), strict=True):
        assert a.stamp_ns == b.stamp_ns
        assert (a.nav.matrix() == b.nav.matrix()).all()


def test_a_fresh_estimator_owes_nothing_to_the_one_before():
    _, samples, antenna, lidar = recorded(end_s=4.0)
    config = machine()
    messages = in_order(samples, antenna, lidar)
    run(config, messages)
    fresh = Estimator(config)
    assert not fresh.initialised and not fresh.counts and not fresh.events


@POLICIES
def test_both_node_policies_come_to_the_same_newest_state(nodes):
    _drive, samples, antenna, lidar = recorded()
    messages = in_order(samples, antenna, lidar)
    _, outputs = run(machine(graph={"nodes": nodes}), messages)
    _, reference = run(machine(graph={"nodes": "imu" if nodes == "measurement" else "measurement"}), messages)
    a, b = estimates(outputs)[-1], estimates(reference)[-1]
    assert a.stamp_ns == b.stamp_ns and seconds(a.stamp_ns) > END_S
    assert apart(a.nav, b.nav)[0] < 0.005
    step = a.nav.localCoordinates(b.nav)
    sigma = np.sqrt(np.diag(a.covariance))
    assert (abs(step) < 3.0 * sigma).all()


def test_the_node_policy_decides_where_nodes_are():
    _, samples, antenna, lidar = recorded()
    messages = in_order(samples, antenna, lidar)
    nodes = {}
    for policy in ("measurement", "imu"):
        stamps = node_stamps(run(machine(graph={"nodes": policy}), messages)[1])
        nodes[policy] = stamps[(stamps > ns(5.0)) & (stamps < ns(7.0))]
    # 10 + 5 measurements and 100 samples a second, in two seconds; while only the IMU measures a node each 0.5 s
    assert 28 <= len(nodes["measurement"]) <= 32
    assert 215 <= len(nodes["imu"]) <= 235
    used = np.array([m.stamp_ns for m in antenna + lidar])
    off_ns = np.array([abs(used - stamp).min() for stamp in nodes["measurement"]])
    assert (off_ns <= NODE_RESOLUTION_NS // 2).sum() >= len(off_ns) - 2


def node_stamps(outputs):
    """The stamps of the nodes that have settled."""
    return np.array([stamp_ns for output in outputs for stamp_ns, _ in output.smoothed])
