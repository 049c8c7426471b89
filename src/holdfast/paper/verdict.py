"""The verdict on one run: that of the judge, and the statistics of the paper's tables."""

from collections.abc import Sequence
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.evaluation.absolute import Statistics, summarise
from holdfast.evaluation.at_fixes import AtFixes, at_fixes
from holdfast.evaluation.corrections import corrections
from holdfast.evaluation.evidence import Published, Truth
from holdfast.evaluation.outages import Outage, nominal, outage_spans, within
from holdfast.evaluation.percentiles import percentiles
from holdfast.evaluation.scenario import judge
from holdfast.evaluation.spans import Span
from holdfast.evaluation.states import StateErrors, state_errors
from holdfast.messages import Array
from holdfast.paper.curves import Curves, curves, curves_at_fixes, curves_of_corrections, curves_of_outcomes
from holdfast.paper.results import Growth, OutageScore
from holdfast.paper.stream import OutcomeLog
from holdfast.replay.published import PublishedRecorder
from holdfast.ros.rows import quaternion_xyzw
from holdfast.state import OptimisedState, Trajectory

AFTER_S = (1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0, 120.0, 150.0, 180.0)


def verdict(recorder: PublishedRecorder, truth: Truth, start_ns: int) -> dict[str, Any]:
    """Return the fields of a `Run` that judge what was published.

    Raises:
        EstimatorError: nothing was published.
    """
    published = recorder.published()
    judged = judge(published, truth)
    errors = state_errors(published.world, truth.states)
    times_s, spans = spans_of(published, truth)
    good = nominal(times_s, spans)
    parts = {"good": good, "outage": within(times_s, spans), "all": np.ones(len(times_s), dtype=np.bool_)}
    moved = _corrections(published, recorder.optimised)
    timing = recorder.timing
    return {
        "scores": judged.scores,
        "errors": _statistics(errors, parts) | _against_fixes(at_fixes(published.world.poses, truth, good)),
        "corrections_m": None if moved is None else summarise(moved[1]),
        "imu_us": percentiles(np.frombuffer(timing.imu_ns, dtype=np.int64) * 1e-3),
        "update_ms": percentiles(np.frombuffer(timing.update_ns, dtype=np.int64) * 1e-6),
        "real_time_factor": timing.real_time_factor or nan,
        "outages": tuple(_outage(outage) for outage in judged.outages),
        "growth": _growth(errors, times_s, spans),
        "outcomes": recorder.outcomes(),
        "events": recorder.event_rows(start_ns),
    }


def all_curves(recorder: PublishedRecorder, truth: Truth, log: OutcomeLog) -> Curves:
    """Return every curve of a run."""
    published = recorder.published()
    times_s, spans = spans_of(published, truth)
    fixes = at_fixes(published.world.poses, truth, nominal(times_s, spans))
    found = curves(published, truth, state_errors(published.world, truth.states))
    found |= curves_at_fixes(published, truth, fixes) | curves_of_outcomes(truth, log)
    moved = _corrections(published, recorder.optimised)
    return found if moved is None else found | curves_of_corrections(truth, *moved)


def spans_of(published: Published, truth: Truth) -> tuple[Array, list[Span]]:
    """Return the times (N,) [s] of what was published, and the outages among them."""
    times_s = truth.seconds(published.world.poses.stamps_ns)
    return times_s, outage_spans(truth, Span(float(times_s[0]), float(times_s[-1])))


def _statistics(errors: StateErrors, parts: dict[str, NDArray[np.bool_]]) -> dict[str, Statistics]:
    quantities = {
        "position_m": np.linalg.norm(errors.position, axis=1),
        "horizontal_m": np.linalg.norm(errors.position[:, :2], axis=1),
        "vertical_m": errors.position[:, 2],
        "heading_deg": np.degrees(errors.attitude[:, 2]),
        "velocity_m_s": np.linalg.norm(errors.tangent[:, 6:], axis=1),
    }
    found: dict[str, Statistics] = {}
    for part, where in parts.items():
        for name, values in quantities.items():
            statistics = summarise(values[where])
            if statistics is not None:
                found[f"{part}/{name}"] = statistics
    return found


def _against_fixes(found: AtFixes) -> dict[str, Statistics]:
    lengths, axes = summarise(np.linalg.norm(found.residuals, axis=1)), summarise(found.residuals.ravel())
    return {} if lengths is None or axes is None else {"good/rtk_m": lengths, "good/rtk_axes_m": axes}


def _corrections(published: Published, optimised: Sequence[OptimisedState]) -> tuple[NDArray[np.int64], Array] | None:
    """Return stamps and |propagated - optimised| of every update that made a newer state; None without any."""
    first, last = (int(published.world.poses.stamps_ns[k]) for k in (0, -1))
    newest: list[OptimisedState] = []
    for state in optimised:
        if first <= state.stamp_ns <= last and (not newest or state.stamp_ns > newest[-1].stamp_ns):
            newest.append(state)
    if len(newest) < 2:
        return None
    track = Trajectory(
        np.array([state.stamp_ns for state in newest], dtype=np.int64),
        np.array([state.nav.position() for state in newest]),
        np.array([quaternion_xyzw(state.nav.attitude()) for state in newest]),
    )
    return corrections(published.world.poses, track)


def _growth(errors: StateErrors, times_s: Array, spans: Sequence[Span]) -> tuple[Growth, ...]:
    """Return the errors at times since the beginning of the longest outage."""
    longest = max(spans, key=lambda span: span.end_s - span.start_s, default=None)
    if longest is None:
        return ()
    afters_s = [after_s for after_s in AFTER_S if longest.start_s + after_s < longest.end_s]
    rows = np.searchsorted(times_s, longest.start_s + np.array(afters_s)).clip(0, len(times_s) - 1)
    return tuple(
        Growth(
            after_s=after_s,
            horizontal_m=float(np.hypot(*errors.position[row, :2])),
            vertical_m=float(abs(errors.position[row, 2])),
            heading_deg=float(abs(np.degrees(errors.attitude[row, 2]))),
        )
        for after_s, row in zip(afters_s, rows.tolist(), strict=True)
    )


def _outage(outage: Outage) -> OutageScore:
    return OutageScore(
        start_s=outage.span.start_s,
        end_s=outage.span.end_s,
        horizontal_rms_m=outage.horizontal_rms_m,
        vertical_rms_m=outage.vertical_rms_m,
        heading_rms_deg=outage.heading_rms_deg,
        alone_horizontal_rms_m=outage.alone_horizontal_rms_m,
        settled_s=outage.settled_s,
        regained_s=outage.regained_s,
    )
