"""The figures of the paper's report, from its results."""

from collections.abc import Iterator, Mapping, Sequence
from statistics import fmean

import numpy as np

from holdfast.evaluation.consistency import chi_square_quantile
from holdfast.messages import Array
from holdfast.paper.results import Results, Run, by_system
from holdfast.paper.study import TASKS
from holdfast.paper.systems import ENGINE, SYSTEMS, TITLES
from holdfast.paper.tables import OURS
from holdfast.report.figures import (
    COLOURS,
    GREY,
    Band,
    Line,
    Panel,
    counted_areas,
    curves,
    over_time,
    track_map,
)
from holdfast.report.page import Figure

COLOUR = dict(zip((*SYSTEMS, ENGINE), COLOURS, strict=False)) | {"truth": GREY}
MARGIN_S = 15.0
PROBABILITY = 0.95
DOF = 3
Columns = Mapping[str, Array]


def drawn(results: Results) -> list[str]:
    """Return the tasks of which there are curves to draw; where every system has failed there are none."""
    return [scenario for scenario in TASKS if _curves(results, scenario)]


def tracks(results: Results, scenario: str) -> Figure:
    """Return the tracks of all systems from above, seed 0."""
    found = _curves(results, scenario)
    true = found[OURS] if OURS in found else next(iter(found.values()))
    lines = [Line("truth", true["true_x_m"], true["true_y_m"], GREY, width=5.0)]
    lines += [_line(system, of["x_m"], of["y_m"]) for system, of in found.items()]
    return Figure(f"track-{scenario}", f"Tracks, {scenario}", track_map(lines), "Seed 0, position of the IMU.")


def figure_three(results: Results) -> Iterator[Figure]:
    """Yield Fig. 3: errors of position over the construction task, and the height through its outage."""
    found, bands = _curves(results, "construction"), _bands(results, "construction")
    error = [
        _line(system, of["time_s"], 1e3 * np.sqrt(of["east_m"] ** 2 + of["north_m"] ** 2 + of["up_m"] ** 2))
        for system, of in found.items()
    ]
    rtk = [_line(system, of["rtk_time_s"], 1e3 * of["rtk_m"]) for system, of in found.items() if "rtk_m" in of]
    panels = [Panel("against truth [mm]", error, "log"), Panel("against RTK [mm]", rtk, "log")]
    yield Figure(
        "figure-3-error",
        "Fig. 3, error of position over the construction task",
        over_time(panels, bands),
        "Above: against the truth; below: distance of the antenna from the fixes, where GNSS is good.",
    )
    begin, end = _window(bands)
    of_z = _with_truth(found, "z_m", "true_z_m", begin, end)
    ups = [_line(s, *_within(of["time_s"], 1e3 * of["up_m"], begin, end)) for s, of in found.items()]
    yield Figure(
        "figure-3-z",
        "Fig. 3, the height through the outage",
        over_time([Panel("z [m]", of_z), Panel("error of z [mm]", ups)], bands),
        "The paper shows z alone; its truth was not known there.",
    )


def figure_four(results: Results) -> Figure:
    """Return Fig. 4: x and y through the degraded interval of the navigation task."""
    found, bands = _curves(results, "navigation"), _bands(results, "navigation")
    begin, end = _window(bands)
    panels = [Panel(f"{axis} [m]", _with_truth(found, f"{axis}_m", f"true_{axis}_m", begin, end)) for axis in "xy"]
    for axis, name in (("x", "east_m"), ("y", "north_m")):
        lines = [_line(s, *_within(of["time_s"], of[name], begin, end)) for s, of in found.items()]
        panels.append(Panel(f"error of {axis} [m]", lines))
    return Figure(
        "figure-4",
        "Fig. 4, x and y through the degraded interval of the navigation task",
        over_time(panels, bands),
        "Shaded: without a good fix, by the truth of the fixes.",
    )


def figure_six(results: Results) -> Figure:
    """Return Fig. 6: |propagated - optimised| over the navigation task."""
    found, bands = _curves(results, "navigation"), _bands(results, "navigation")
    lines = [
        _line(s, of["correction_time_s"], np.maximum(1e3 * of["correction_m"], 1e-2))
        for s, of in found.items()
        if "correction_m" in of
    ]
    return Figure(
        "figure-6",
        "Fig. 6, consistency: |propagated − optimised|",
        over_time([Panel("[mm]", lines, "log")], bands),
        "Of each update the distance between the state that was published at its time and the optimised one; "
        "worst since the point before.",
    )


def latency(results: Results) -> Figure:
    """Return the distribution of the latencies."""
    lines = []
    for one in results.latency:
        if one.quantiles_us:
            quantiles, values = (np.array(column) for column in zip(*one.quantiles_us, strict=True))
            lines.append(_line(one.system, values, 100.0 * quantiles))
    return Figure(
        "latencies",
        "Latency of the IMU path, distribution",
        curves(lines, "time from IMU sample to state [us]", "fraction of samples below [%]", "log"),
    )


def consistency(results: Results, scenario: str) -> Figure:
    """Return NEES and NIS over time with their bounds."""
    found, bands = _curves(results, scenario), _bands(results, scenario)
    panels = []
    for key, label in (
        ("nees_attitude", "NEES, attitude"),
        ("nees_position", "NEES, position"),
        ("nees_velocity", "NEES, velocity"),
        ("nis", "NIS of fixes"),
    ):
        time = "rtk_time_s" if key == "nis" else "time_s"
        lines = [_line(system, of[time], np.clip(of[key], 1e-3, 1e6)) for system, of in found.items() if key in of]
        panels.append(Panel(f"{label} [1]", [*lines, *_bounds(found)], "log"))
    caption = (
        f"Per degree of freedom: 1 on average for a consistent covariance. Dashed: {100 * PROBABILITY:.0f} % bounds of "
        "a single value. Above: overconfident; below: too pessimistic."
    )
    return Figure(f"nees-{scenario}", f"Consistency of the covariance, {scenario}", over_time(panels, bands), caption)


def steps(results: Results, scenario: str) -> Figure:
    """Return the steps of the odometry frame."""
    bands = _bands(results, scenario)
    found = {system: of for system, of in _curves(results, scenario).items() if of["step_m"].any()}
    moved = [_line(s, of["time_s"], np.maximum(1e3 * of["step_m"], 1e-3)) for s, of in found.items()]
    turned = [_line(s, of["time_s"], np.maximum(of["step_deg"], 1e-5)) for s, of in found.items()]
    panels = [Panel("step [mm]", moved, "log"), Panel("rotation [deg]", turned, "log")]
    caption = "Departure of each pose in O from the one before, propagated by the IMU: what a controller sees. "
    return Figure(
        f"steps-{scenario}",
        f"Steps of the odometry frame, {scenario}",
        over_time(panels, bands),
        caption + "Worst since the point before. A baseline has no such frame: its own jumps show.",
    )


def chassis(results: Results, scenario: str) -> Figure | None:
    """Return the errors of the chassis beyond those of the cabin; None where no system has one."""
    found = {s: of for s, of in _curves(results, scenario).items() if "base_m" in of}
    if not found:
        return None
    away = [_line(s, of["time_s"], 1e3 * of["base_m"]) for s, of in found.items()]
    rate = [_line(s, of["time_s"], of["base_yaw_rate_rad_s"]) for s, of in found.items()]
    panels = [Panel("position [mm]", away), Panel("yaw rate [rad/s]", rate)]
    return Figure(f"chassis-{scenario}", f"Chassis, beyond the cabin's error, {scenario}", over_time(panels))


def gate(results: Results, scenario: str) -> Figure | None:
    """Return the outcomes of the fixes of ours over time; None where they are not known."""
    of = _curves(results, scenario).get(OURS, {})
    counts: dict[str, Array] = {}
    for name, values in of.items():
        if name.startswith("outcome:") and values.any():
            outcome = name.rpartition(":")[2].replace("_", " ")
            counts[outcome] = counts.get(outcome, 0.0) + np.maximum(values, 0.0)
    if not counts:
        return None
    counts = dict(sorted(counts.items(), key=lambda item: -float(item[1].sum())))
    return Figure(
        f"gate-{scenario}",
        f"Decisions of the gate, {scenario}",
        counted_areas(of["outcome_time_s"], counts, "measurements per second"),
        "Outcomes of the fixes of all antennas and of the headings.",
    )


def growth(results: Results) -> Figure | None:
    """Return how the error grows in an outage: mean over the seeds; None if it was not run."""
    panels = []
    for key, label, factor in (
        ("horizontal_m", "horizontal [mm]", 1e3),
        ("vertical_m", "vertical [mm]", 1e3),
        ("heading_deg", "heading [deg]", 1.0),
    ):
        lines = []
        for system, runs in by_system(results.of("growth")):
            times = sorted({one.after_s for run in runs for one in run.growth})
            means = [
                factor * fmean(getattr(one, key) for run in runs for one in run.growth if one.after_s == at)
                for at in times
            ]
            lines.append(_line(system, np.array(times), np.maximum(np.array(means), 1e-3)))
        panels.append(Panel(label, lines, "log"))
    if not panels[0].lines:
        return None
    return Figure(
        "growth",
        "Growth of the error in an outage, tunnel",
        over_time(panels, label="time without GNSS [s]"),
        "Mean over the seeds.",
    )


def sensitivity(results: Results) -> Iterator[Figure]:
    """Yield the error over delays and clock offsets of a kind of sensor."""
    runs = results.of("sensitivity")
    for key, label in (("delay_s", "delay"), ("clock_s", "clock offset")):
        for sensor in dict.fromkeys(run.sensor for run in runs if getattr(run, key)):
            lines = list(_sensitive(runs, sensor, key))
            yield Figure(
                f"sensitivity-{key.removesuffix('_s')}-{sensor}",
                f"Sensitivity: {label} of {sensor}",
                curves(lines, f"{label} [ms]", "horizontal RMS, whole run [mm]", vertical="log"),
                "In addition to those in the configuration.",
            )


def _sensitive(runs: Sequence[Run], sensor: str, key: str) -> Iterator[Line]:
    for system, of in by_system(runs):
        chosen = [run for run in of if (run.sensor == sensor and getattr(run, key)) or not run.sensor]
        points = sorted((getattr(run, key), run.errors["all/horizontal_m"].rms) for run in chosen)
        values = np.array(points).reshape(-1, 2)
        yield _line(system, 1e3 * values[:, 0], 1e3 * values[:, 1])


def _curves(results: Results, scenario: str) -> dict[str, Columns]:
    """Return the curves of seed 0 by system, in their order."""
    names = {system: f"{scenario}-0-{system}" for system in SYSTEMS}
    return {system: results.curves[name] for system, name in names.items() if name in results.curves}


def _line(system: str, x: Array, y: Array) -> Line:
    return Line(TITLES[system], x, y, COLOUR[system], width=2.0 if system == OURS else 1.2, is_on_top=system == OURS)


def _bands(results: Results, scenario: str) -> list[Band]:
    runs = [run for run in results.of("accuracy", scenario) if run.seed == 0 and run.outages]
    return [Band(one.start_s, one.end_s, name="no good fix") for one in (runs[0].outages if runs else ())]


def _window(bands: Sequence[Band]) -> tuple[float, float]:
    """Return the longest outage with a margin on both sides."""
    longest = max(bands, key=lambda band: band.end_s - band.start_s, default=Band(0.0, np.inf))
    return longest.start_s - MARGIN_S, longest.end_s + MARGIN_S


def _within(times: Array, values: Array, begin: float, end: float) -> tuple[Array, Array]:
    inside = (times >= begin) & (times <= end)
    return times[inside], values[inside]


def _with_truth(found: Mapping[str, Columns], name: str, true: str, begin: float, end: float) -> list[Line]:
    any_of = next(iter(found.values()))
    lines = [Line("truth", *_within(any_of["time_s"], any_of[true], begin, end), GREY, "solid", 4.0)]
    return lines + [_line(system, *_within(of["time_s"], of[name], begin, end)) for system, of in found.items()]


def _bounds(found: Mapping[str, Columns]) -> list[Line]:
    if not found:
        return []
    ends = np.array([min(of["time_s"][0] for of in found.values()), max(of["time_s"][-1] for of in found.values())])
    tail = (1.0 - PROBABILITY) / 2.0
    limits = [chi_square_quantile(tail, DOF) / DOF, chi_square_quantile(1.0 - tail, DOF) / DOF]
    return [Line("bounds", ends, np.full(2, limit), "#1d2630", "dash", 1.0) for limit in limits]
