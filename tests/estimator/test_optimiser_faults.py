"""An optimisation that fails is reported, and the estimator goes on from its last good state."""

import numpy as np
import pytest
from motion import Drive, deviation, estimates, fixes, imu, in_order, machine, ns, run, scans

from holdfast.events import EventKind
from holdfast.graph.smoother import Smoother
from holdfast.graph.window import Window


def driven(failures, monkeypatch, from_s=5.0, end_s=11.0):
    """A drive whose first so many optimisations after a time fail."""
    rng = np.random.default_rng(1)
    drive = Drive()
    messages = in_order(
        imu(drive, 0.0, end_s, 100.0, rng),
        fixes(drive, 0.0, end_s, 10.0, rng, phase_s=0.0137),
        scans(drive, 0.0, end_s, 5.0, rng, phase_s=0.0071),
    )
    left, solve = [failures], Window.solve

    def failing(window, oldest_ns):
        if oldest_ns >= ns(from_s - 3.0) and left[0] > 0:  # the lag
            left[0] -= 1
            raise RuntimeError("indeterminate system\nnear x42")
        solve(window, oldest_ns)

    monkeypatch.setattr(Window, "solve", failing)
    estimator, outputs = run(machine(), messages)
    monkeypatch.undo()
    assert left[0] == 0
    return drive, estimator, estimates(outputs)


@pytest.mark.parametrize("failures", [1, 10])
def test_estimates_go_on_and_come_back_to_the_truth_after_failures(failures, monkeypatch):
    drive, estimator, given = driven(failures, monkeypatch)
    faults = [event for event in estimator.events if event.kind is EventKind.OPTIMISER_FAULT]
    assert len(faults) == failures and faults[0].reason == "indeterminate system"
    stamps = np.array([e.stamp_ns for e in given])
    assert (np.diff(stamps) == 10_000_000).all()  # one for every sample
    for e in given:
        assert np.isfinite(e.nav.matrix()).all() and np.linalg.eigvalsh(e.covariance).min() > -1e-9
    assert max(deviation(drive, e)[0] for e in given if e.stamp_ns > ns(10.0)) < 0.1
    assert max(deviation(drive, e)[1] for e in given if e.stamp_ns > ns(10.0)) < np.radians(2.0)


def test_fifty_failures_in_a_row_are_survived(monkeypatch):
    drive, estimator, given = driven(50, monkeypatch, from_s=4.5, end_s=13.0)
    assert sum(event.kind is EventKind.OPTIMISER_FAULT for event in estimator.events) == 50
    assert all(np.isfinite(e.covariance).all() and np.isfinite(e.nav.matrix()).all() for e in given)
    assert max(deviation(drive, e)[0] for e in given if e.stamp_ns > ns(12.0)) < 0.1


def test_after_a_failure_the_covariance_is_larger_and_comes_back(monkeypatch):
    _, _, failed = driven(1, monkeypatch)
    _, _, clean = driven(0, monkeypatch)
    ratio = {
        a.stamp_ns: np.trace(a.covariance[3:6, 3:6]) / np.trace(b.covariance[3:6, 3:6])
        for a, b in zip(failed, clean, strict=True)
    }
    after = [r for stamp, r in ratio.items() if ns(5.02) < stamp < ns(5.1)]
    assert max(after) > 1.5
    # the heading lost trust as well, and is found again more slowly
    assert ratio[ns(11.0)] < 2.0 < max(after)


@pytest.mark.parametrize("error", [IndexError, RuntimeError, ValueError])
def test_it_goes_on_where_gtsam_raises_what_nobody_has_expected(error, monkeypatch):
    rng, drive = np.random.default_rng(1), Drive()
    messages = in_order(imu(drive, 0.0, 11.0, 100.0, rng), fixes(drive, 0.0, 11.0, 10.0, rng, phase_s=0.0137))
    settled, left = Smoother.settled, [3]

    def failing(smoother):
        if smoother.newest_ns > ns(5.0) and left[0] > 0:
            left[0] -= 1
            raise error("Requested variable 'x0' is not in this VectorValues.\nmore")
        return settled(smoother)

    monkeypatch.setattr(Smoother, "settled", failing)
    estimator, outputs = run(machine(lidar=False), messages)
    reasons = [event.reason for event in estimator.events if event.kind is EventKind.OPTIMISER_FAULT]
    text = f"{error.__name__}: Requested variable 'x0' is not in this VectorValues.: going on from the last state"
    assert reasons == [text] * 3
    given = estimates(outputs)
    assert (np.diff([one.stamp_ns for one in given]) == 10_000_000).all()
    assert max(deviation(drive, one)[0] for one in given if one.stamp_ns > ns(5.5)) < 0.1
