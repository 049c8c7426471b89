"""The optimum over a recording: better than the causal estimate, the same in windows, and not misled."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import Drive, fixes, imu, in_order, machine, ns, scans, seconds, twists

from holdfast.estimator.estimator import Estimator
from holdfast.events import Outcome
from holdfast.smoothing.batch_smoother import BatchSmoother
from holdfast.smoothing.segment import Segment

END_S = 40.0
MOTION = Drive()


def drive(seed=0, end_s=END_S, lidar=True, of_fixes=lambda fixes: fixes, of_imu=lambda samples: samples):
    rng = np.random.default_rng(seed)
    streams = [
        of_imu(imu(MOTION, 0.0, end_s, rng=rng)),
        of_fixes(fixes(MOTION, 0.0, end_s, 5.0, rng=rng, phase_s=0.0037)),
    ]
    return in_order(*streams, *([scans(MOTION, 0.0, end_s, rng=rng, phase_s=0.0021)] if lidar else []))


def smoothed(messages, config=None, window_s=300.0, overlap_s=120.0):
    """The stretches of the optimum, the causal estimates, and the estimator."""
    batch = BatchSmoother(config or machine(), window_s, overlap_s)
    estimator = Estimator(config or machine(), batch)
    causal = [output.estimate for output in map(estimator.process, messages) if output.estimate is not None]
    batch.stop()
    assert not batch.failures
    return batch.take(), causal, estimator


def errors(times_ns, positions):
    return np.linalg.norm(
        [p - MOTION.nav(seconds(t)).position() for t, p in zip(times_ns, positions, strict=True)], axis=1
    )


def track_errors(blocks):
    return np.concatenate([errors(block.track.times_ns.tolist(), block.track.positions) for block in blocks])


def causal_errors(causal):
    return errors([estimate.stamp_ns for estimate in causal], [estimate.position for estimate in causal])


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def counts(blocks, sensor, outcome):
    return sum(block.counts[sensor, outcome] for block in blocks)


def without(start_s, end_s):
    return lambda fixes: [fix for fix in fixes if not start_s <= seconds(fix.stamp_ns) < end_s]


@pytest.fixture(scope="module")
def nominal():
    return smoothed(drive())


def test_the_optimum_is_closer_to_the_truth_than_the_causal_estimate(nominal):
    blocks, causal, _ = nominal
    assert rms(track_errors(blocks)) < 0.7 * rms(causal_errors(causal)) < 0.02


def test_there_is_a_state_at_every_sample_between_the_first_node_and_the_last(nominal):
    times = nominal[0][0].track.times_ns
    assert len(times) > 3700 and set(np.diff(times).tolist()) == {10_000_000}


def test_the_covariance_explains_the_errors():
    nees = []
    for seed in range(3):
        (block,), _, _ = smoothed(drive(seed, 20.0))
        track, nodes = block.track, block.covariances.at(block.track.times_ns)
        for t, p, (x, y, z, w), P in zip(
            track.times_ns.tolist(), track.positions, track.quaternions, nodes, strict=True
        ):
            nav = MOTION.nav(seconds(t))
            e = gtsam.Rot3.Quaternion(w, x, y, z).unrotate(nav.position() - p)
            nees.append(e @ np.linalg.solve(P[3:6, 3:6], e) / 3.0)
    assert 0.4 < np.mean(nees) < 2.0


def test_velocities_are_those_of_the_positions(nominal):
    track = nominal[0][0].track
    moved = np.gradient(track.positions, track.times_ns * 1e-9, axis=0)
    assert abs(moved - track.velocities)[5:-5].max() < 0.05


def test_windows_that_overlap_agree_with_one_window(nominal):
    blocks, _, _ = smoothed(drive(), window_s=10.0, overlap_s=8.0)
    assert len(blocks) >= 3
    (whole,) = nominal[0]
    times = np.concatenate([block.track.times_ns for block in blocks])
    assert np.array_equal(times, whole.track.times_ns)
    positions = np.concatenate([block.track.positions for block in blocks])
    assert abs(positions - whole.track.positions).max() < 2e-3  # what lies more than 8 s ahead tells so much
    last = len(blocks[-1].track.times_ns)
    assert abs(positions - whole.track.positions)[-last:].max() < 1e-5  # the past is handed on
    variances = np.concatenate([block.covariances.at(block.track.times_ns)[:, 3, 3] for block in blocks])
    ratio = variances / whole.covariances.at(times)[:, 3, 3]
    assert ratio.min() > 0.99 and ratio.max() < 1.5 and abs(ratio[-last:] - 1.0).max() < 1e-3


def test_an_outage_is_bridged_from_both_sides():
    gap = without(15.0, 30.0)
    blocks, causal, _ = smoothed(drive(lidar=False, of_fixes=gap), machine(lidar=False))
    inside = [e for e in causal if 15.0 < seconds(e.stamp_ns) < 30.0]
    track = blocks[0].track
    rows = (track.times_ns > ns(15.0)) & (track.times_ns < ns(30.0))
    assert rms(track_errors(blocks)[rows]) < 0.3 * rms(causal_errors(inside))


def test_fixes_that_lie_are_refused_and_named():
    def lying(fixes):
        return [
            replace(fix, latitude_deg=fix.latitude_deg + 8e-6) if 20.0 <= seconds(fix.stamp_ns) < 24.0 else fix
            for fix in fixes
        ]

    blocks, _, _ = smoothed(drive(of_fixes=lying))
    refused = [one for block in blocks for one in block.refused if one.weight < 0.5]
    assert len(refused) == counts(blocks, "gnss", Outcome.CONTRADICTED) >= 20
    assert {one.sensor for one in refused} == {"gnss"}
    assert sum(20.0 <= seconds(one.stamp_ns) < 24.1 for one in refused) == 20
    assert track_errors(blocks).max() < 0.1


def test_fixes_that_came_too_late_for_the_causal_estimate_are_used():
    def late(fixes):
        return [
            replace(fix, arrival_ns=fix.arrival_ns + 5_000_000_000) if 10.0 <= seconds(fix.stamp_ns) < 12.0 else fix
            for fix in fixes
        ]

    blocks, _, estimator = smoothed(drive(of_fixes=late))
    was_late = estimator.counts["gnss", Outcome.LATE]
    assert was_late == 10
    assert counts(blocks, "gnss", Outcome.USED) >= estimator.counts["gnss", Outcome.USED] + was_late


def test_a_drop_out_of_the_imu_is_crossed_and_said():
    def silent(samples):
        return [sample for sample in samples if not 20.0 < seconds(sample.stamp_ns) < 21.0]

    blocks, _, _ = smoothed(drive(of_imu=silent))
    track = blocks[0].track
    assert track_errors(blocks).max() < 0.1
    assert track.from_imu.mean() > 0.99
    assert max(np.diff(track.times_ns)) == 1_000_000_000


def test_smoothing_twice_gives_the_same_bits(nominal):
    (again,), _, _ = smoothed(drive())
    (once,) = nominal[0]
    assert again.track.positions.tobytes() == once.track.positions.tobytes()
    assert again.covariances.values.tobytes() == once.covariances.values.tobytes()


def test_a_reset_ends_one_stretch_and_begins_another():
    batch = BatchSmoother(machine())
    estimator = Estimator(machine(), batch)
    for message in drive(end_s=25.0):
        if message.sensor == "imu" and message.stamp_ns == ns(12.0):
            estimator.reset()
        estimator.process(message)
    batch.stop()
    first, second = batch.take()
    assert first.track.times_ns[-1] < second.track.times_ns[0]
    assert max(track_errors([first]).max(), track_errors([second]).max()) < 0.1


def test_the_scale_factor_of_a_wheel_is_learnt():
    config = machine(more={"wheels": {"kind": "twist", "scale_sigma": 0.05, "frame": "imu"}})
    messages = in_order(drive(end_s=20.0), twists(MOTION, 0.0, 20.0, scale=1.03))
    blocks, _, _ = smoothed(messages, config)
    estimate, sigmas = blocks[-1].constants["wheels"][:2]
    assert abs(estimate[0] - 0.03) < 0.01 and sigmas[0] < 0.02


def test_fixes_that_walk_away_are_not_believed_because_the_first_of_them_agree():
    def walking(fixes):
        moved = []
        for fix in fixes:
            since_s = seconds(fix.stamp_ns) - 20.0
            shift_deg = 2e-6 * min(max(since_s, 0.0), 10.0) if since_s < 12.0 else 0.0
            moved.append(replace(fix, latitude_deg=fix.latitude_deg + shift_deg))
        return moved

    blocks, _, _ = smoothed(drive(of_fixes=walking))
    assert track_errors(blocks).max() < 0.15
    refused = [one for block in blocks for one in block.refused if one.weight < 0.5]
    assert sum(23.0 <= seconds(one.stamp_ns) < 32.0 for one in refused) == 45


def test_a_window_that_cannot_be_solved_is_said_and_the_next_one_goes_on(monkeypatch):
    solve, calls = Segment.solve, []

    def failing(segment):
        calls.append(segment)
        if len(calls) == 1:
            raise RuntimeError("indeterminate")
        return solve(segment)

    monkeypatch.setattr(Segment, "solve", failing)
    batch = BatchSmoother(machine(), 10.0, 5.0)
    estimator = Estimator(machine(), batch)
    for message in drive():
        estimator.process(message)
    batch.stop()
    assert len(batch.failures) == 1 and "indeterminate" in batch.warnings()[0]
    blocks = batch.take()
    assert seconds(int(blocks[0].track.times_ns[0])) > 10.0 and track_errors(blocks).max() < 0.1


def test_what_a_listener_does_never_reaches_back(nominal):
    plain = Estimator(machine())
    estimates = [output.estimate for output in map(plain.process, drive()) if output.estimate is not None]
    assert [one.values.tobytes() for one in estimates] == [one.values.tobytes() for one in nominal[1]]
