"""The page about a calibration: each number before and after, what was observable, and what held-out fixes say.

Importing it needs plotly: the extra `report`.
"""

from collections.abc import Sequence
from importlib.metadata import version
from math import isfinite

from holdfast.calibration.calibrate import Calibration
from holdfast.calibration.estimated import Estimated, Family
from holdfast.calibration.held_out import HeldOut
from holdfast.report.figures import quantiles
from holdfast.report.page import Block, Cell, Figure, Mark, Page, Provenance, Section, Table, Text, digest

ENDED = "It ended early: what held-out fixes could not judge any more is not written."
COLUMNS = ("number", "key", "unit", "before", "after", "sigma", "sigma / prior", "written")


def calibration_page(of: Calibration, command: str) -> Page:
    """Return the page; `command` makes it again."""
    versions = {name: version(name) for name in ("holdfast", "gtsam", "numpy")}
    provenance = Provenance(command, versions, digest(of.before.model_dump(mode="json")))
    sections = [
        Section("Numbers", _numbers(of)),
        Section("What was observable", _observable(of.estimates)),
        Section("Held-out errors", _held_out(of.held_out)),
        Section("The file", [Text("What differs stands below a comment with its old value."), _file(of)]),
    ]
    return Page("Calibration", lead(of), provenance, sections)


def lead(of: Calibration) -> str:
    """Return what came of it in a few sentences."""
    written = [one for one in of.estimates if one.is_written]
    unseen = [one for one in of.estimates if one.reason.startswith("not observable")]
    refused = sorted({one.family for one in of.estimates if " say no: " in one.reason})
    text = (
        f"From {', '.join(of.recordings)}: {len(written)} of {len(of.estimates)} numbers are otherwise than configured "
        f"and are written, {len(unseen)} could not be observed and keep what the file says. "
        + (f"Constants came to rest after {of.rounds} run{'s' * (of.rounds != 1)}." if of.failure is None else ENDED)
    )
    if len(of.held_out) > 1:
        first, last = of.held_out[0], of.held_out[-1]
        text += f" At held-out fixes the horizontal RMS is {_change(first, last, in_outage=False)} with GNSS"
        if isfinite(first.rms(in_outage=True)):
            text += f", and {_change(first, last, in_outage=True)} in cut outages"
        text += "."
    if refused:
        text += f" Not written, because held-out errors would grow: {', '.join(refused)}."
    return text


def _change(before: HeldOut, after: HeldOut, *, in_outage: bool) -> str:
    one, other = (held.rms(in_outage=in_outage) * 1e3 for held in (before, after))
    return f"{one:.1f} mm before and {other:.1f} mm after"


def _numbers(of: Calibration) -> list[Block]:
    blocks: list[Block] = [
        Text(
            "Rotations and lever arms are differences to the file. A number that is not written has the reason in the "
            "last column."
        )
    ]
    for family in Family:
        rows = [one for one in of.estimates if one.family is family]
        if rows:
            cells: list[Sequence[Cell]] = [
                (one.what, one.key, one.unit, one.before, one.after, one.sigma, _ratio(one), one.reason or "yes")
                for one in rows
            ]
            marks: dict[tuple[int, int], Mark] = {
                (k, len(COLUMNS) - 1): "reached" for k, one in enumerate(rows) if one.is_written
            }
            blocks.append(Table(family.name.lower(), family[0].upper() + family[1:], COLUMNS, cells, marks=marks))
    return blocks


def _ratio(one: Estimated) -> float | None:
    return one.sigma / one.prior if one.prior > 0.0 else None


def _observable(estimates: Sequence[Estimated]) -> list[Block]:
    ratios = {f"{one.what} ({one.path[-1]})": ratio for one in estimates if (ratio := _ratio(one)) is not None}
    if not ratios:
        return [Text("Nothing was to be estimated.")]
    plot = quantiles({"sigma / prior": ratios}, "sigma after over sigma before [1]")
    plot.update_layout(height=140 + 22 * len(ratios))
    caption = "At one the recording says nothing that the file does not; above a half nothing is written."
    return [Figure("observable", "How much the recordings say", plot, caption)]


def _held_out(verdicts: Sequence[HeldOut]) -> list[Block]:
    if not verdicts:
        return [Text("No number that positions depend on has changed, so there was nothing to judge.")]
    columns = ("configuration", "with GNSS [mm]", "fixes", "in cut outages [mm]", "fixes in them")
    rows: list[Sequence[Cell]] = [
        (
            one.label,
            one.rms(in_outage=False) * 1e3,
            int((~one.in_outage).sum()),
            one.rms(in_outage=True) * 1e3,
            int(one.in_outage.sum()),
        )
        for one in verdicts
    ]
    caption = (
        "Horizontal RMS of the causal track at fixes that the estimator never had, each at its own stamp with the "
        "offset of that configuration; the noise of the fixes is in it. Families are added one after the other; one "
        "that makes it worse is left out."
    )
    table = Table("held_out", "Errors at held-out fixes", columns, rows, caption)
    kinds = (("with GNSS", False), ("in cut outages", True))
    values = {
        name: {one.label: one.rms(in_outage=lost) * 1e3 for one in verdicts}
        for name, lost in kinds
        if all(isfinite(one.rms(in_outage=lost)) for one in verdicts)
    }
    plot = quantiles(values, "horizontal RMS [mm]")
    return [table, Figure("held_out_figure", "Before and after", plot)]


def _file(of: Calibration) -> Block:
    lines = of.text.splitlines()
    rows = [
        (number + 2, lines[number + 1].strip() if number + 1 < len(lines) else "", line.strip().removeprefix("# "))
        for number, line in enumerate(lines)
        if line.strip().startswith("# calibrated: ")
    ]
    return Table("file", "Changed lines", ("line", "now", "comment"), rows)
