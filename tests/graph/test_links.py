"""The links between nodes: they fill the time, by the IMU where it measured and by a motion model where it did not."""

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, G, fixes, imu, in_order, machine, ns
from rig import buffered, enter, position, smoother_of, truth

from holdfast.graph.smoother import Smoother
from holdfast.graph.window import Window

DRIVE = Drive(start_s=-3.0)
POLICIES = pytest.mark.parametrize("nodes", ["measurement", "imu"])


class Watched(Window):
    """A window that keeps where its variables are, and the motions between them."""

    def __init__(self):
        thresholds = gtsam.ISAM2ThresholdMap()
        for letter, size in (("x", 9), ("b", 6)):
            thresholds.insert((letter, np.full(size, 0.01)))
        super().__init__(thresholds)
        self.stamps, self.links = {}, []

    def insert(self, key, value, stamp_ns):
        super().insert(key, value, stamp_ns)
        self.stamps[key] = stamp_ns

    def add(self, factor):
        placed = super().add(factor)
        if isinstance(factor, gtsam.ImuFactor2):
            self.links.append(placed)
        return placed

    def retract(self, placed):
        super().retract(placed)
        self.links = [link for link in self.links if link is not placed]

    def spans(self):
        """Start, end, integrated time, and whether a motion model stands in for the IMU, of each link in order."""
        found = []
        for link in self.links:
            start, end = (self.stamps[key] for key in list(link.factor.keys())[:2])
            motion = link.factor.preintegratedMeasurements()
            per_second = motion.preintMeasCov()[6:, 6:].max() / motion.deltaTij()
            found.append((start, end, motion.deltaTij(), per_second > 1.0))  # (1.5 m/s^2)^2/Hz against (2e-3)^2
        return sorted(found)


def watched(samples, antenna, end_s, nodes="measurement"):
    windows = []

    def new():
        windows.append(Watched())
        return windows[-1]

    config = machine(graph={"nodes": nodes, "lag_s": 60.0})
    buffer = buffered(DRIVE, 0.0, config, samples=samples[:1])
    smoother = Smoother(config, buffer, G, truth(DRIVE, 0.0), new)
    for message in in_order(samples[1:], antenna):
        if message.sensor == "imu":
            added = buffer.add(message)
            if added.line_since_ns is not None:
                smoother.mark_silent(added.line_since_ns)
        elif message.stamp_ns < buffer.latest_ns:
            smoother.node(message.stamp_ns)
    smoother.node(ns(end_s))
    smoother.optimise()
    return smoother, windows[-1]


@POLICIES
def test_links_fill_the_time_and_each_integrates_exactly_that_between_its_nodes(nodes):
    """IMU stamps off the grid of nodes: a node may be rounded past the newest sample, the motion must not be lost."""
    rng = np.random.default_rng(4)
    samples = imu(DRIVE, 0.0, 6.0, 100.0, rng, phase_s=-0.00006)
    delayed = fixes(DRIVE, 0.0, 5.0, 10.0, phase_s=0.00506, delay_s=0.1)
    _, window = watched(samples, delayed, 5.5, nodes)
    spans = window.spans()
    assert len(spans) > 50
    assert (spans[0][0], spans[-1][1]) == (ns(0.0), ns(5.5))
    assert [end for _, end, *_ in spans[:-1]] == [start for start, *_ in spans[1:]]
    for start, end, integrated_s, is_gap in spans:
        assert integrated_s == pytest.approx((end - start) * 1e-9, abs=1e-9)
        assert not is_gap


GAP_S = (2.0, 3.5)


def missing(samples):
    return [s for s in samples if not ns(GAP_S[0]) < s.stamp_ns < ns(GAP_S[1])]


def on_a_line(samples):
    first, last = (next(k for k, s in enumerate(samples) if s.stamp_ns >= ns(t)) for t in GAP_S)
    for k in range(first + 1, last):
        w = (k - first) / (last - first)
        for field in ("specific_force", "angular_velocity"):
            a, b = getattr(samples[first], field), getattr(samples[last], field)
            getattr(samples[k], field)[:] = (1.0 - w) * a + w * b
    return samples


def frozen(samples):
    first = next(s for s in samples if s.stamp_ns >= ns(GAP_S[0]))
    for sample in samples:
        if ns(GAP_S[0]) < sample.stamp_ns < ns(GAP_S[1]):
            sample.specific_force[:], sample.angular_velocity[:] = first.specific_force, first.angular_velocity
    return samples


@POLICIES
@pytest.mark.parametrize("spoil", [missing, on_a_line, frozen])
def test_no_imu_factor_spans_a_gap_and_a_motion_model_spans_all_of_it(spoil, nodes):
    samples = spoil(imu(DRIVE, 0.0, 5.0, 100.0, np.random.default_rng(4)))
    _, window = watched(samples, fixes(DRIVE, 0.0, 5.0, 10.0, phase_s=0.0137), 5.0, nodes)
    gaps = [(start, end) for start, end, _, is_gap in window.spans() if is_gap]
    assert (gaps[0][0], gaps[-1][1]) == (ns(GAP_S[0]), pytest.approx(ns(GAP_S[1]), abs=10_000_000))
    assert sum(end - start for start, end in gaps) == gaps[-1][1] - gaps[0][0]


def test_the_window_is_bounded_however_long_it_goes_on():
    windows = []

    def new():
        windows.append(Watched())
        return windows[-1]

    smoother = smoother_of(DRIVE, 12.0, new_solver=new)
    sizes = []
    for t in np.arange(0.05, 12.0, 0.1):
        enter(smoother, position(DRIVE, t, ARM))
        smoother.optimise()
        sizes.append((len(smoother), len(windows[-1]), windows[-1].factor_count))
    assert len(windows) == 1
    early, late = np.max(sizes[40:60], axis=0), np.max(sizes[-20:], axis=0)
    np.testing.assert_allclose(late, early, atol=3)
    assert early[0] <= 32  # a lag of 3 s at 10 Hz
