"""The section on consistency: innovations with their bounds, claimed standard deviations, biases of the IMU."""

import numpy as np

from holdfast.report.figures import COLOURS, GREY, Line, Panel, over_time
from holdfast.report.outages import LOST, outage_bands
from holdfast.report.page import Block, Cell, Figure, Table
from holdfast.report.run_record import InnovationScore, Measurements, RunRecord
from holdfast.report.trajectory import FIXES, fixes

LEAST_NIS = 1e-3  # on a logarithmic axis


def consistency(run: RunRecord) -> list[Block]:
    """Return the blocks of the section."""
    return [*_innovations(run), *_claims(run)]


def _innovations(run: RunRecord) -> list[Block]:
    if not run.scores:
        return []
    rows: list[list[Cell]] = [
        [s.name, s.tested, s.mean_per_dof, _interval(s), 100.0 * s.fraction_inside, s.bound] for s in run.scores
    ]
    head = ("sensor", "tested", "mean NIS / dof", "95 % interval", "inside of the bound [%]", "bound on one NIS")
    caption = (
        "Normalised innovations squared, with the noise by which the estimator weighs each sensor. The mean is that of "
        "what was used: 1 if the covariance is right, more if it is too small. Of independent innovations it lies in "
        "the interval, and 95 % of the single ones below the bound; errors that last make both vary more. Held-out "
        "positions are compared with the published track."
    )
    bounds = {score.name: score.bound for score in run.scores}
    panels = [
        Panel(f"{name} NIS", _nis(run, of, bounds.get(name, bounds.get(f"{name}, held out", np.nan))), "log")
        for name, of in run.measurements.items()
        if np.isfinite(of.nis).any()
    ]
    dashed = "Dashed: the 95 % bound of one innovation. Dotted: the limit of the gate, beyond which it is refused."
    return [
        Table("innovations", "Innovations by sensor", head, rows, caption),
        Figure("nis", "Innovations (NIS) over time", over_time(panels, outage_bands(run)), dashed),
    ]


def _interval(score: InnovationScore) -> str | None:
    if score.lower_per_dof is None or score.upper_per_dof is None:
        return None
    return f"{score.lower_per_dof:.2f} to {score.upper_per_dof:.2f}"


def _nis(run: RunRecord, of: Measurements, bound: float) -> list[Line]:
    times_s, has_nis = run.seconds_of(of.stamps_ns), np.isfinite(of.nis)
    lines = []
    for name, chosen in fixes(of).items():
        shown = chosen & has_nis
        if shown.any():
            lines.append(Line(name, times_s[shown], np.maximum(of.nis[shown], LEAST_NIS), FIXES[name], points=True))
    ends = np.array([0.0, run.end_s])
    lines.append(Line("95 % bound", ends, np.full(2, bound), GREY, "dash"))
    has_limit = np.isfinite(of.limit)
    if has_limit.any():
        lines.append(Line("limit of the gate", times_s[has_limit], of.limit[has_limit], LOST, "dot", 1.0))
    return lines


def _claims(run: RunRecord) -> list[Block]:
    bands = outage_bands(run)
    blocks: list[Block] = []
    if len(run.sigma_times_s):
        panels = [Panel(name, [Line("sigma", run.sigma_times_s, of)], "log") for name, of in run.sigmas.items()]
        blocks.append(Figure("sigmas", "Standard deviations as reported", over_time(panels, bands)))
    if len(run.bias_times_s):
        panels = [Panel("gyroscope [rad/s]", _bias_lines(run, 0)), Panel("accelerometer [m/s²]", _bias_lines(run, 3))]
        caption = "" if run.true_biases is None else "Dotted: the truth of the simulation."
        blocks.append(Figure("biases", "Biases of the IMU, as estimated", over_time(panels, bands), caption))
    return blocks


def _bias_lines(run: RunRecord, first: int) -> list[Line]:
    """Return the lines of three axes, and those of the truth where it is known."""
    lines = []
    for k, axis in enumerate("xyz"):
        lines.append(Line(axis, run.bias_times_s, run.biases[:, first + k], COLOURS[k]))
        if run.true_biases is not None and run.true_bias_times_s is not None:
            lines.append(Line(f"{axis}, true", run.true_bias_times_s, run.true_biases[:, first + k], COLOURS[k], "dot"))
    return lines
