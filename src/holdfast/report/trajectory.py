"""The section on the trajectory: the track with the fixes on it, the motion over time, the odometry frame."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array
from holdfast.report.figures import Line, Panel, over_time, track_map
from holdfast.report.outages import LOST, outage_bands, outages, within
from holdfast.report.page import Block, Cell, Figure, Table, Text
from holdfast.report.run_record import Measurements, RunRecord

REFERENCE, SMOOTHED, OPTIMUM, ODOMETRY = "#9aa5b1", "#56b4e9", "#0072b2", "#7a5195"
FIXES = {"used": "#009e73", "refused": "#e69f00", "held out": "#cc79a7"}  # and what became of them
WAITED = ("before_start", "quarantined", "ignored", "unreached")  # neither used nor refused


def trajectory(run: RunRecord) -> list[Block]:
    """Return the blocks of the section."""
    notes: list[Block] = [Text(note, note=True) for note in run.notes]
    return [*notes, _track(run), *_motion(run), *_odometry_frame(run)]


def fixes(of: Measurements) -> Mapping[str, NDArray[np.bool_]]:
    """Return which measurements (N,) of a sensor were used, refused and held out."""
    used, held = of.outcomes == "used", of.outcomes == "held_out"
    return {"used": used, "refused": ~(used | held | np.isin(of.outcomes, WAITED)), "held out": held}


def _track(run: RunRecord) -> Figure:
    tracks = []
    if run.reference is not None:
        tracks.append(Line("reference", run.reference[:, 0], run.reference[:, 1], REFERENCE, width=5.0))
    tracks += _fixes_on_the_map(run)
    tracks.append(Line("estimate in O", run.odometry[:, 0], run.odometry[:, 1], ODOMETRY, "dot", 1.0))
    if len(run.smoothed):
        tracks.append(Line("smoothed", run.smoothed[:, 0], run.smoothed[:, 1], SMOOTHED))
    if len(run.optimum):
        tracks.append(Line("optimum over the recording", run.optimum[:, 0], run.optimum[:, 1], OPTIMUM))
    tracks.append(Line("estimate, as it was published", run.world[:, 0], run.world[:, 1]))
    inside = within(run.times_s, outages(run))
    if inside.any():
        without = np.where(inside[:, None], run.world[:, :2], np.nan)
        tracks.append(Line("estimate without GNSS", without[:, 0], without[:, 1], LOST, width=3.0))
    (e0, n0), (e1, n1) = run.world[0, :2], run.world[-1, :2]
    marks = {"start": (float(e0), float(n0)), "end": (float(e1), float(n1))}
    plot = track_map(tracks, marks, (run.times_s, run.world[:, 0], run.world[:, 1]))
    datum = run.summary.get("datum")
    where = "in the frame in which it started"
    if datum is not None:
        where = f"from the datum at {datum['latitude_deg']:.7f} deg N, {datum['longitude_deg']:.7f} deg E"
    caption = f"Position of the IMU, {where}. O is the odometry frame: it drifts, and never jumps."
    if any(line.points for line in tracks):
        caption += " Fixes are where the antennas (or prisms) are, one per pixel; refused ones may lie beyond the map."
    return Figure("track", "Track from above", plot, caption)


def _fixes_on_the_map(run: RunRecord) -> list[Line]:
    found: dict[str, list[Array]] = {name: [] for name in FIXES}
    for of in run.measurements.values():
        is_position = np.isfinite(of.positions).all(axis=1)
        for name, chosen in fixes(of).items():
            found[name].append(of.positions[chosen & is_position, :2])
    lines = []
    for name, parts in found.items():
        at = np.concatenate([np.zeros((0, 2)), *parts])
        if len(at):
            east, north, is_far = at[:, 0], at[:, 1], name == "refused"  # these are few, and what is looked for
            line = Line(f"fixes, {name}", east, north, FIXES[name], points=True, is_on_top=is_far, is_framed=not is_far)
            lines.append(line)
    return lines


def _motion(run: RunRecord) -> list[Block]:
    bands = outage_bands(run)
    height = [Line("as published", run.times_s, run.world[:, 2])]
    if len(run.smoothed):
        height.append(Line("smoothed", run.smoothed_times_s, run.smoothed[:, 2], SMOOTHED))
    panels = [Panel("height [m]", height)]
    if len(run.sigma_times_s):
        panels.append(Panel("speed [m/s]", [Line("as published", run.sigma_times_s, run.speeds)]))
    angles = [
        Panel(f"{name} [deg]", [Line("as published", run.times_s, run.attitude[:, k])])
        for k, name in enumerate(("roll", "pitch", "yaw"))
    ]
    yaw = "Attitude of the IMU in W; yaw is 0 to the east, counter-clockwise, and goes on beyond 180 deg."
    return [
        Figure("height-and-speed", "Height and speed", over_time(panels, bands), "Height is above the datum."),
        Figure("attitude", "Roll, pitch and yaw", over_time(angles, bands), yaw),
    ]


def _odometry_frame(run: RunRecord) -> list[Block]:
    bands = outage_bands(run)
    where = [Line(name, run.times_s, run.correction[:, k]) for k, name in enumerate(("east", "north", "up"))]
    panels = [Panel("T_W_O [m]", where), Panel("T_W_O yaw [deg]", [Line("yaw", run.times_s, run.correction[:, 3])])]
    departures = {name: _departure(track) for name, track in (("in W", run.world), ("in O", run.odometry))}
    lines = [Line(name, run.times_s[2:], np.maximum(1e3 * of, 1e-4)) for name, of in departures.items()]
    rows: list[list[Cell]] = [
        [name, *(1e3 * float(np.quantile(of, q)) for q in (0.5, 0.99, 1.0))] for name, of in departures.items()
    ]
    caption = "T_W_O takes every correction in W: a consumer of poses in O never sees one."
    why = "Distance of each estimate from the straight continuation of the two before it: acceleration, or a jump."
    return [
        Figure("correction", "The odometry frame in the world", over_time(panels, bands), caption),
        Figure("departure", "Steps", over_time([Panel("departure [mm]", lines, "log")], bands), why),
        Table("departures", "Departure from the straight continuation",
              ("frame", "median [mm]", "p99 [mm]", "max [mm]"), rows),
    ]  # fmt: skip


def _departure(positions: Array) -> Array:
    """Return |p_k - 2 p_{k-1} + p_{k-2}| (N - 2,) of positions (N, 3) [m]."""
    departure: Array = np.linalg.norm(np.diff(positions, n=2, axis=0), axis=1)
    return departure
