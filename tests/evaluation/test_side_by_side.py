"""Several systems are judged at the same stamps, over segments of the same lengths."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from holdfast.errors import RecordingError
from holdfast.evaluation.accuracy import Interval, Metrics, evaluate
from holdfast.evaluation.association import Association
from holdfast.evaluation.plot_systems import plot_systems
from holdfast.evaluation.side_by_side import segment_lengths_m, side_by_side
from holdfast.messages import Array
from holdfast.state import Trajectory

COUNT = 1000
EAST_M = np.linspace(0.0, 200.0, COUNT)
REFERENCE = Trajectory(
    np.arange(COUNT) * 100_000_000,
    np.column_stack([EAST_M, 0.0 * EAST_M, 0.0 * EAST_M]),
    np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)),
)


def estimate(scale: float = 1.0, shift_m: float = 0.0, keep: Array | slice = slice(None)) -> Trajectory:
    positions = REFERENCE.positions * np.array([scale, 1.0, 1.0]) + np.array([0.0, shift_m, 0.0])
    return Trajectory(REFERENCE.stamps_ns[keep], positions[keep], REFERENCE.quaternions[keep])


def test_each_system_has_the_verdict_that_it_has_alone() -> None:
    estimates = {"a": estimate(shift_m=0.3), "b": estimate(scale=1.01)}
    for system in side_by_side(estimates, REFERENCE, "none", Metrics()):
        alone = evaluate(estimates[system.name], REFERENCE)
        assert system.accuracy.scores == alone.scores
        assert system.own_pairs == COUNT


def test_a_system_that_is_silent_where_it_would_be_wrong_gains_nothing() -> None:
    """All are judged where all have a pose: else the one with gaps looks better, or worse, than it is."""
    wrong = estimate(scale=1.1)
    early = estimate(keep=slice(0, 400))
    whole, short = side_by_side({"whole": wrong, "short": early}, REFERENCE, "none", Metrics())
    assert (whole.own_pairs, short.own_pairs) == (COUNT, 400)
    assert whole.accuracy.scores["all"].pairs == short.accuracy.scores["all"].pairs == 400
    assert whole.accuracy.scores["all"].ape["horizontal_m"].max == pytest.approx(0.1 * EAST_M[399])


def test_segments_are_fractions_of_the_distance_and_show_the_drift() -> None:
    exact, drifting = side_by_side({"a": estimate(), "b": estimate(scale=1.02)}, REFERENCE, "none", Metrics())
    assert list(exact.segments) == [20.0, 40.0, 60.0, 80.0, 100.0]
    for length_m, errors in drifting.segments.items():
        assert np.median(errors) == pytest.approx(0.02 * length_m, rel=0.01)
    assert exact.segment_statistics()["100 m"].rms == pytest.approx(0.0, abs=1e-9)


def test_lengths_that_are_asked_for_are_used_and_those_beyond_the_track_have_no_statistics() -> None:
    (system,) = side_by_side({"a": estimate()}, REFERENCE, "none", Metrics(), (50.0, 5000.0))
    assert list(system.segment_statistics()) == ["50 m"]


def test_a_reference_that_stands_still_has_no_segments() -> None:
    still = replace(REFERENCE, positions=0.0 * REFERENCE.positions)
    (system,) = side_by_side({"a": still}, still, "none", Metrics())
    assert (segment_lengths_m(system.accuracy.pairs), system.segment_statistics()) == ((), {})


def test_systems_without_a_common_time_are_refused() -> None:
    apart = {"a": estimate(keep=slice(0, 300)), "b": estimate(keep=slice(600, None))}
    with pytest.raises(RecordingError, match="no time at which all of a, b have a pose"):
        side_by_side(apart, REFERENCE, "none", Metrics())


def test_an_error_names_the_system() -> None:
    with pytest.raises(RecordingError, match=r"^late: no overlap in time"):
        side_by_side(
            {"a": estimate(), "late": replace(estimate(), stamps_ns=REFERENCE.stamps_ns + 10**15)},
            REFERENCE,
            "none",
            Metrics(),
        )


def test_nearest_stamps_that_differ_between_systems_are_compared_in_the_time_that_all_cover() -> None:
    options = Metrics(association=Association(method="nearest", max_difference_s=0.06))
    odd = replace(estimate(keep=slice(1, 700, 2)), stamps_ns=REFERENCE.stamps_ns[1:700:2] + 3_000_000)
    systems = side_by_side({"a": estimate(keep=slice(0, None, 2)), "b": odd}, REFERENCE, "none", options)
    assert [len(system.accuracy.pairs) for system in systems] == [349, 350]


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_figure_of_eight_systems_is_drawn_twice_alike(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib")
    estimates = {f"system {k}": estimate(scale=1.0 + 0.001 * 4**k, shift_m=0.1 * k) for k in range(8)}
    metrics = Metrics(intervals=(Interval("tunnel", 20.0, 40.0),))
    systems = side_by_side(estimates, REFERENCE, "none", metrics)
    for name in ("one", "two"):
        plot_systems(systems, tmp_path / f"{name}{suffix}", "eight")
    assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()
    assert (tmp_path / f"one{suffix}").stat().st_size > 10_000
