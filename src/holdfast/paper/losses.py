"""Where ours loses, in words: every row in which a baseline does better, and every target that is not reached."""

from collections.abc import Sequence
from math import nan
from statistics import fmean

from holdfast.evaluation.mapping import WHOLE
from holdfast.paper.maps import Maps
from holdfast.paper.results import Results
from holdfast.paper.study import TASKS
from holdfast.paper.systems import SYSTEMS, TITLES
from holdfast.paper.tables import OURS, QUANTITIES, Lost, faster_baselines, lost_cells

CONSISTENT_MM = (3.0, 15.0)  # target of the mean and the std of |propagated - optimised| on the navigation task
MAX_MAP_LOSS_PERCENT = 2.0  # of a map to that of the true poses


def accuracy_in_words(results: Results, scenario: str) -> str:
    """Return in which rows of Table I a baseline does better than ours on a task."""
    if not results.of("accuracy", scenario, OURS):
        return f"In {scenario} ours has no verdict, and so loses to every baseline that has one."
    lost = [one for one in lost_cells(results) if one.scenario == scenario]
    rows = list(dict.fromkeys(one.quantity.key for one in lost))
    if not rows:
        return f"In {scenario} no baseline does better than ours in any row."
    listed = "; ".join(_row_in_words([one for one in lost if one.quantity.key == key]) for key in rows)
    return f"In {scenario} ours loses {len(rows)} of {len(QUANTITIES)} rows to a baseline: {listed}."


def latency_in_words(results: Results) -> list[str]:
    """Return which baselines answer sooner than ours."""
    on = {"imu_cpu_us": "samples without an update", "every_cpu_us": "average over all samples, updates too,"}
    return [
        f"On {which} {TITLES[baseline]} answers sooner than {TITLES[ours]}: after {theirs_us:.1f} us of CPU time, "
        f"ours after {ours_us:.1f} us."
        for times, which in on.items()
        for ours, baseline, ours_us, theirs_us in faster_baselines(results, times)
    ]


def consistency_in_words(results: Results) -> list[str]:
    """Return whether the published states of the navigation task exceed the target, or a baseline's are nearer."""
    found = {}
    for name in SYSTEMS:
        of = [run.corrections_m for run in results.of("accuracy", "navigation", name) if run.corrections_m is not None]
        if of:
            found[name] = (1e3 * fmean(one.mean for one in of), 1e3 * fmean(one.std for one in of))
    if OURS not in found:
        return []
    mean, std = found[OURS]
    lines = []
    if mean > CONSISTENT_MM[0] or std > CONSISTENT_MM[1]:
        target = f"the target is {CONSISTENT_MM[0]:g} and {CONSISTENT_MM[1]:g} mm"
        lines.append(f"Ours does not reach its target: {mean:.2f} mm mean, {std:.2f} mm std; {target}.")
    for name, (theirs, _) in found.items():
        if name not in (OURS, "paper") and theirs < mean:
            lines.append(f"{TITLES[name]} is nearer to its optimised states: {theirs:.2f} mm mean, ours {mean:.2f} mm.")
    return lines


def maps_in_words(maps: Maps) -> list[str]:
    """Return whose map is nearer to the site than ours, and where ours loses too much to that of the true poses."""
    lines = []
    for scenario in TASKS:
        of = {score.system: score.closeness.get(WHOLE) for score in maps if score.scenario == scenario}
        percent = {name: 100.0 * near.fraction_within for name, near in of.items() if near is not None}
        ours = percent.get(OURS, nan)
        for name, theirs in percent.items():
            if name in SYSTEMS and name not in (OURS, "paper") and theirs > ours:
                lines.append(
                    f"In {scenario} the map of {TITLES[name]} is better: {theirs:.2f} % within 5 cm, ours {ours:.2f} %."
                )
        true = percent.get("truth", nan)
        if true - ours > MAX_MAP_LOSS_PERCENT:
            lines.append(
                f"In {scenario} our map does not reach its target: {ours:.2f} % within 5 cm, the true poses {true:.2f}."
            )
    return lines


def _row_in_words(lost: Sequence[Lost]) -> str:
    quantity, ours = lost[0].quantity, lost[0].ours
    rivals = ", ".join(f"{TITLES[one.system]} {one.theirs.mean:.{quantity.digits}f}" for one in lost)
    most = max(ours.mean - one.theirs.mean for one in lost)
    doubt = ", which is less than the std over the seeds" if ours.runs > 1 and most < ours.std else ""
    return f"{quantity.label} ({rivals}, ours {ours.mean:.{quantity.digits}f} {quantity.unit}{doubt})"
