"""Where ours loses, in words: every row in which a baseline does better, and every target of the evaluation missed."""

from collections.abc import Sequence
from math import nan
from statistics import fmean

from holdfast.evaluation.mapping import WHOLE
from holdfast.paper.maps import Maps
from holdfast.paper.results import Results
from holdfast.paper.study import TASKS
from holdfast.paper.systems import SYSTEMS, TITLES
from holdfast.paper.tables import OURS, QUANTITIES, Lost, faster_baselines, lost_cells

CONSISTENT_MM = (3.0, 15.0)  # mean and deviation of |propagated - optimised| to be reached on the navigation task
MAP_POINTS = 2.0  # of per cent that a map may lose to that of the true poses


def accuracy_in_words(results: Results, scenario: str) -> str:
    """Say of Table I in how many rows of a task a baseline does better than ours, and in which."""
    if not results.of("accuracy", scenario, OURS):
        return f"In {scenario} ours has no verdict, and so loses to every baseline that has one."
    lost = [one for one in lost_cells(results) if one.scenario == scenario]
    rows = list(dict.fromkeys(one.quantity.key for one in lost))
    if not rows:
        return f"In {scenario} no baseline does better than ours in any row."
    told = "; ".join(_row_in_words([one for one in lost if one.quantity.key == key]) for key in rows)
    return f"In {scenario} ours loses {len(rows)} of {len(QUANTITIES)} rows to a baseline: {told}."


def latency_in_words(results: Results) -> list[str]:
    """Say which baselines answer sooner than ours."""
    on = {"imu_cpu_us": "samples without an update", "every_cpu_us": "average over all samples, updates too,"}
    return [
        f"On {which} {TITLES[baseline]} answers sooner than {TITLES[ours]}: after {theirs_us:.1f} us of the processor, "
        f"ours after {ours_us:.1f} us."
        for times, which in on.items()
        for ours, baseline, ours_us, theirs_us in faster_baselines(results, times)
    ]


def consistency_in_words(results: Results) -> list[str]:
    """Say whether the published states of the navigation task miss the target, or a baseline's are nearer."""
    found = {}
    for name in SYSTEMS:
        of = [run.corrections_m for run in results.of("accuracy", "navigation", name) if run.corrections_m is not None]
        if of:
            found[name] = (1e3 * fmean(one.mean for one in of), 1e3 * fmean(one.std for one in of))
    if OURS not in found:
        return []
    mean, std = found[OURS]
    said = []
    if mean > CONSISTENT_MM[0] or std > CONSISTENT_MM[1]:
        asked = f"{CONSISTENT_MM[0]:g} and {CONSISTENT_MM[1]:g} mm were to be reached"
        said.append(f"Ours misses its target: {mean:.2f} mm mean, {std:.2f} mm deviation; {asked}.")
    for name, (theirs, _) in found.items():
        if name not in (OURS, "paper") and theirs < mean:
            said.append(f"{TITLES[name]} is nearer to its optimised states: {theirs:.2f} mm mean, ours {mean:.2f} mm.")
    return said


def maps_in_words(maps: Maps) -> list[str]:
    """Say whose map lies nearer to the site than ours, and where ours loses too much to that of the true poses."""
    said = []
    for scenario in TASKS:
        of = {score.system: score.closeness.get(WHOLE) for score in maps if score.scenario == scenario}
        share = {name: 100.0 * near.share_within for name, near in of.items() if near is not None}
        ours = share.get(OURS, nan)
        for name, theirs in share.items():
            if name in SYSTEMS and name not in (OURS, "paper") and theirs > ours:
                said.append(
                    f"In {scenario} the map of {TITLES[name]} is better: {theirs:.2f} % within 5 cm, ours {ours:.2f} %."
                )
        true = share.get("truth", nan)
        if true - ours > MAP_POINTS:
            said.append(
                f"In {scenario} our map misses its target: {ours:.2f} % within 5 cm, that of the true poses {true:.2f}."
            )
    return said


def _row_in_words(lost: Sequence[Lost]) -> str:
    quantity, ours = lost[0].quantity, lost[0].ours
    rivals = ", ".join(f"{TITLES[one.system]} {one.theirs.mean:.{quantity.digits}f}" for one in lost)
    most = max(ours.mean - one.theirs.mean for one in lost)
    doubt = ", which is less than the spread over the seeds" if ours.runs > 1 and most < ours.spread else ""
    return f"{quantity.label} ({rivals}, ours {ours.mean:.{quantity.digits}f} {quantity.unit}{doubt})"
