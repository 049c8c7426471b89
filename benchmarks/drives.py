"""Prints the accuracy on the cars of `drives/` with what `config init` writes: `python benchmarks/drives.py`.

Every second fix is held out and judges, beside linear interpolation between the fixes that were used (which sees the
future) and the baselines MSF and TSIF. Then GNSS is cut for 10, 30 and 60 s, again and again. One drive alone:
`python benchmarks/drives.py --drive rtk_drive --no-outages`. The baselines cannot start in motion nor find a heading:
they begin at the first standstill after Holdfast's first 20 s, with the heading that Holdfast has there.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from math import inf, nan
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from holdfast.baselines.msf import make_msf
from holdfast.baselines.tsif import make_tsif
from holdfast.config.load import parse_config
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind, Health, Outcome
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.geometry.world import World
from holdfast.messages import GnssFix, Message
from holdfast.recording.first_config import first_config
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.held_out import HeldOutJudge, HoldOut, HoldOutFilter, Judgement
from holdfast.sensors.registry import sensors_of

LENGTHS_S = (10.0, 30.0, 60.0)
FIRST_OUTAGE_S, BETWEEN_OUTAGES_S = 40.0, 30.0
OUTAGE = "start_s", "end_m", "up_m", "nees", "fix_m", "fix_up_m", "back_s"  # what is told of one
NEES_3_SIGMA = 14.16  # chi-square with three degrees of freedom, 99.73 %
BASELINES: dict[str, Callable[[Config], Any]] = {"MSF": make_msf, "TSIF": make_tsif}
BASELINE_AFTER_NS, BASELINE_BEFORE_NS = 20_000_000_000, 10_000_000_000
EVERYDAY = {EventKind.REJECTED, EventKind.LATE, EventKind.WAITING, EventKind.HEALTH, EventKind.INITIALISED}


@dataclass
class Run:
    """What one system made of one drive; the rows of `track` are stamp [ns], east, north [m], yaw [rad]."""

    waiting_for: str = ""
    judged: list[tuple[Judgement, bool]] = field(default_factory=list)
    track: list[tuple[int, float, float, float]] = field(default_factory=list)
    events: Counter[str] = field(default_factory=Counter)
    frame: LocalFrame | None = None
    used: list[Message] = field(default_factory=list)
    wall_s: float = 0.0
    crashed_ns: float = inf


def starter_config(bag: Path) -> Config:
    """Return the configuration that `config init` writes."""
    with open_recording(bag) as opened:
        return parse_config(first_config(opened))


def recorded_in(data: Path) -> list[Path]:
    """Return the drives below a folder that have a recording."""
    return [drive for drive in sorted(data.glob("*")) if (drive / "bag").exists()]


def messages_of(drive: Path, config: Config) -> list[Message]:
    """Return all messages of a drive."""
    with open_recording(drive / "bag") as opened:
        return list(opened.read(subscriptions(config)))


def run_system(system: Any, messages: list[Message], rules: Sequence[HoldOut], from_ns: int = 0) -> Run:
    """Replay messages; fixes that the rules hold back are judged. Messages before `from_ns` are passed over."""
    run, held_out = Run(), HoldOutFilter(rules, system.config)
    judge = HeldOutJudge(system.config, system if isinstance(system, Estimator) else None)
    for message in held_out.split(messages):
        if message.stamp_ns < from_ns:
            held_out.held.clear()
            continue
        began = perf_counter()
        try:
            output = system.process(message)
        except (ValueError, RuntimeError) as error:  # what came until then is judged all the same
            run.crashed_ns = message.stamp_ns
            run.events[f"CRASHED at {(message.stamp_ns - messages[0].stamp_ns) * 1e-9:.0f} s ({error})"] = 1
            break
        run.wall_s += perf_counter() - began
        run.events.update(str(event.kind) for event in system.take_events() if event.kind not in EVERYDAY)
        if isinstance(message, GnssFix):
            run.used.append(message)
        if system.datum is not None and (run.frame is None or run.frame.datum != system.datum):
            run.frame = LocalFrame(system.datum)
        while held_out.held:
            judge.add_message(*held_out.held.popleft())
        if output.estimate is not None:
            nav = output.estimate.nav
            run.track.append((output.estimate.stamp_ns, *nav.position()[:2], nav.attitude().yaw()))
            judge.add_estimate(output.estimate, run.frame)
        if output.optimised is not None:
            judge.add_optimised(output.optimised, run.frame)
        is_nominal = getattr(system, "health", Health.NOMINAL) is Health.NOMINAL
        run.judged += [(judgement, is_nominal) for judgement in judge.judgements[len(run.judged) :]]
    run.waiting_for = "" if run.track else system.waiting_for
    return run


def run_baseline(
    make: Callable[[Config], Any], config: Config, messages: list[Message], rules: Sequence[HoldOut], ours: Run
) -> Run:
    """Replay a baseline from where it can start with our heading."""
    track, probe = np.array(ours.track).reshape(-1, 4), make(config)
    for message in messages:
        probe.process(message)
        stamp_ns = message.stamp_ns
        can_start = isinstance(message, GnssFix) and probe.waiting_for.startswith("standing still")
        if can_start and len(track) and track[0, 0] + BASELINE_AFTER_NS <= stamp_ns <= track[-1, 0]:
            yaw = track[np.searchsorted(track[:, 0], stamp_ns), 3]
            start = config.initialisation.model_copy(update={"heading_deg": float(np.degrees(yaw))})
            system = make(config.model_copy(update={"initialisation": start}))
            return run_system(system, messages, rules, stamp_ns - BASELINE_BEFORE_NS)
    return Run(waiting_for=probe.waiting_for)


def positions(config: Config, fixes: Sequence[Message], frame: LocalFrame | None) -> np.ndarray:
    """Return stamp [ns], east, north and sigma [m] of the fixes that are usable by what the receiver says."""
    world = World(frame)
    found = [sensors_of(config)[fix.sensor].convert(fix, world) for fix in fixes]
    usable = [one for one in found if not isinstance(one, Outcome)]
    rows = [(p.stamp_ns, *p.p_W_P[:2], np.sqrt(p.covariance[:2, :2].diagonal().max())) for p in usable]
    return np.array(rows).reshape(-1, 4)


def rms(values: Any) -> float:
    """Return the root mean square; NaN of nothing."""
    values = np.asarray(values)
    return float(np.sqrt(np.mean(values**2))) if values.size else nan


def held_out_row(config: Config, run: Run, messages: list[Message], reference: Path) -> dict[str, Any]:
    """Sum up a replay with every second fix held out."""
    fixes = [message for message in messages if isinstance(message, GnssFix)]
    if not run.judged:
        return {"waiting_for": run.waiting_for or "no held-out fix could be judged"}
    judgements = [judgement for judgement, _ in run.judged]
    errors = np.array([np.hypot(*j.error[:2]) for j in judgements])
    used, stamps = positions(config, run.used, run.frame), np.array([j.stamp_ns for j in judgements], dtype=float)
    line = np.column_stack([np.interp(stamps, used[:, 0], used[:, axis]) for axis in (1, 2)])
    off_line = np.linalg.norm(line - [j.position[:2] for j in judgements], axis=1)
    return {
        "start_s": (run.track[0][0] - fixes[0].stamp_ns) * 1e-9,
        "n": len(errors),
        "rms": rms(errors),
        "line": rms(off_line),
        "ratio": rms(errors) / rms(off_line),
        "nominal": rms(errors[[nominal for _, nominal in run.judged]]),
        "max": float(errors.max()),
        "nees": float(np.mean([j.nees for j in judgements])) / 3.0,
        "reference": against_reference(run, reference_in(reference, run.frame)),
        "factor": (messages[-1].arrival_ns - messages[0].arrival_ns) * 1e-9 / run.wall_s,
        "events": ", ".join(f"{kind} {count}" for kind, count in sorted(run.events.items())),
    }


def reference_in(file: Path, frame: LocalFrame | None) -> np.ndarray:
    """Return stamp [ns], east, north and up [m] of the receiver's own sensor fusion; none without it."""
    if not file.exists() or frame is None:
        return np.zeros((0, 4))
    rows = np.genfromtxt(file, delimiter=",", skip_header=1)
    return np.array([(np.round(row[0] * 1e3) * 1e6, *frame.to_enu(Geodetic(*row[1:4]))) for row in rows])


def against_reference(run: Run, reference: np.ndarray) -> float:
    """Return the RMS distance from a reference to the nearest estimate [m], or NaN without it."""
    if not len(reference):
        return nan
    track = np.array(run.track)
    rows = reference[(reference[:, 0] >= track[0, 0]) & (reference[:, 0] <= track[-1, 0])]
    at = np.searchsorted(track[:, 0], rows[:, 0])
    at -= rows[:, 0] - track[at - 1, 0] < track[at, 0] - rows[:, 0]
    return rms(np.linalg.norm(track[at, 1:3] - rows[:, 1:3], axis=1))


def outage_starts(messages: list[Message], length_s: float) -> np.ndarray:
    """Return when outages begin, in seconds after the first message."""
    lasts_s = (messages[-1].stamp_ns - messages[0].stamp_ns) * 1e-9
    return np.arange(FIRST_OUTAGE_S, lasts_s - length_s - 10.0, length_s + BETWEEN_OUTAGES_S)


def outage_rows(
    config: Config, run: Run, messages: list[Message], starts: np.ndarray, length_s: float, *, reference: Path
) -> list[dict[str, float]]:
    """Return, for every outage, when it began, the error and NEES at its end, and how long it took to return.

    `fix_m` and `fix_up_m`: by how much the fix that judges is itself beside the reference, NaN without one. `back_s`:
    from the fifth used fix until a held-out one is within 3 of its own sigmas; infinite if none is before the next
    outage. After a crash all is infinite. One replay holds all outages of a length, so that one from which the
    estimate does not return spoils the next.
    """
    fixes = positions(config, [message for message in messages if isinstance(message, GnssFix)], run.frame)
    track = reference_in(reference, run.frame)
    sigmas, used = dict(fixes[:, [0, 3]].tolist()), positions(config, run.used, run.frame)[:, 0]
    rows = []
    for start_s in starts:
        began, ended = (messages[0].stamp_ns + at * 1e9 for at in (start_s, start_s + length_s))
        inside = [j for j, _ in run.judged if began <= j.stamp_ns < ended]
        after = [j for j, _ in run.judged if ended <= j.stamp_ns < ended + BETWEEN_OUTAGES_S * 1e9]
        if ended > run.crashed_ns:
            rows.append(dict.fromkeys(OUTAGE, inf) | {"start_s": float(start_s)})
            continue
        if not inside or not after:
            continue  # it had not started
        fifth = used[min(np.searchsorted(used, ended) + 4, len(used) - 1)]
        good = [j.stamp_ns for j in after if np.hypot(*j.error[:2]) <= 3.0 * sigmas[float(j.stamp_ns)]]
        last = inside[-1]
        seen = [np.interp(last.stamp_ns, track[:, 0], track[:, k]) if len(track) else nan for k in (1, 2, 3)]
        beside = last.position - np.array(seen)
        back_s = max(0.0, (good[0] - fifth) * 1e-9) if good else inf
        found = start_s, np.hypot(*last.error[:2]), last.error[2], last.nees, np.hypot(*beside[:2]), beside[2], back_s
        rows.append(dict(zip(OUTAGE, map(float, found), strict=True)))
    return rows


def judge_drive(drive: Path, length_s: float | None, baselines: bool) -> dict[str, Any]:
    """Run all systems on one drive; with a length, GNSS is cut. Runs in a process of its own."""
    config = starter_config(drive / "bag")
    messages = messages_of(drive, config)
    rules, starts = [HoldOut(name, 2) for name in names_of(config, "gnss")], np.zeros(0)
    if length_s is not None:
        starts = outage_starts(messages, length_s)
        cut = names_of(config, "gnss") + names_of(config, "gnss_velocity")
        rules += [HoldOut(name, None, start, start + length_s) for name in cut for start in starts]
    runs = {"Holdfast": run_system(Estimator(config), messages, rules)}
    for title, make in BASELINES.items() if baselines else ():
        runs[title] = run_baseline(make, config, messages, rules, runs["Holdfast"])
    file = drive / "reference.csv"
    if length_s is None:
        return {title: held_out_row(config, run, messages, file) for title, run in runs.items()}
    return {title: outage_rows(config, run, messages, starts, length_s, reference=file) for title, run in runs.items()}


def names_of(config: Config, kind: str) -> list[str]:
    """Return the sensors of a kind."""
    return [name for name, sensor in config.sensors.items() if sensor.kind == kind]


def print_held_out(drives: Sequence[str], results: Sequence[dict[str, Any]]) -> None:
    """Print a row per drive and system, and what they come to."""
    print("\nEvery second fix held out, configuration of `config init`; horizontal errors in m")
    print(
        f"  {'drive':38s} {'system':8s} {'start s':>7s} {'n':>4s} {'RMS':>9s} {'line':>6s} {'ratio':>7s}"
        f" {'nominal':>9s} {'max':>9s} {'NEES/3':>8s} {'reference':>9s} {'x real':>6s}  events"
    )
    for drive, systems in zip(drives, results, strict=True):
        for title, row in systems.items():
            if "waiting_for" in row:
                print(f"  {drive:38s} {title:8s} never started: {row['waiting_for']}")
                continue
            print(
                f"  {drive:38s} {title:8s} {row['start_s']:7.1f} {row['n']:4d} {row['rms']:9.3f} {row['line']:6.3f}"
                f" {row['ratio']:7.2f} {row['nominal']:9.3f} {row['max']:9.2f} {row['nees']:8.2f}"
                f" {row['reference']:9.3f} {row['factor']:6.1f}  {row['events']}"
            )
    for title in results[0]:
        rows = [systems[title] for systems in results if "waiting_for" not in systems[title]]
        if rows:
            ratios, nees = [row["ratio"] for row in rows], [row["nees"] for row in rows]
            print(
                f"  {title}: {len(rows)} of {len(results)} started; ratio to the line: median {np.median(ratios):.2f},"
                f" worst {max(ratios):.2f}; worst error {max(row['max'] for row in rows):.2f} m;"
                f" NEES/3 median {np.median(nees):.2f}"
            )


def print_outages(drives: Sequence[str], length_s: float, results: Sequence[dict[str, Any]]) -> None:
    """Print a row per system: all outages of a length, and below it the median of each drive."""
    print(f"\nGNSS cut for {length_s:.0f} s; error at the end against the last fix that was cut")
    for title in results[0]:
        rows = [row for systems in results for row in systems[title]]
        if not rows:
            print(f"  {title}: no outage after it started")
            continue
        ends = [row["end_m"] for row in rows]
        p90_m = np.sort(ends)[-1 - len(ends) // 10]
        within = 100.0 * np.mean([row["nees"] <= NEES_3_SIGMA for row in rows])
        print(
            f"  {title:8s} {len(rows):3d} outages: median {np.median(ends):8.2f} m, p90 {p90_m:9.2f},"
            f" worst {max(ends):9.2f} m; within 3 sigma {within:5.1f} %;"
            f" {sum(row['back_s'] > 5.0 for row in rows)} not back within 3 sigma of the fixes 5 s after the fifth"
        )
        for drive, systems in zip(drives, results, strict=True):
            if systems[title]:
                median_m = np.median([row["end_m"] for row in systems[title]])
                print(f"    {drive:38s} {len(systems[title]):3d} outages: median {median_m:8.2f} m")
            for row in systems[title]:
                if title == "Holdfast" and row["nees"] > NEES_3_SIGMA:
                    print(
                        f"      beyond 3 sigma: from {row['start_s']:.0f} s, horizontally {row['end_m']:.2f} m,"
                        f" up {row['up_m']:+.2f} m, NEES/3 {row['nees'] / 3.0:.1f}; the fix is beside the reference by"
                        f" {row['fix_m']:.2f} m, up {row['fix_up_m']:+.2f} m"
                    )


def print_drives(
    data: Path, only: Sequence[str] = (), lengths_s: Sequence[float] = LENGTHS_S, baselines: bool = True
) -> None:
    """Run and print the drives below a folder: all of them, or those that are named."""
    drives = [drive for drive in recorded_in(data) if drive.name in (only or [drive.name])]
    names = [drive.name for drive in drives]
    for missing in sorted(set(only) - set(names)) or ([] if drives else ["all drives"]):
        print(f"\n{missing}: skipped, no recording at {data}")
    if not drives:
        return
    with ProcessPoolExecutor(2) as pool:
        lengths = None, *lengths_s
        jobs = {length: [pool.submit(judge_drive, drive, length, baselines) for drive in drives] for length in lengths}
        for length, futures in jobs.items():
            results = [future.result() for future in futures]
            if length is None:
                print_held_out(names, results)
            else:
                print_outages(names, length, results)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data" / "drives")
    parser.add_argument("--drive", action="append", default=[], help="only this one; may be given again")
    parser.add_argument("--no-outages", action="store_true")
    parser.add_argument("--length", action="append", type=float, help="of outages [s], in place of 10, 30 and 60")
    parser.add_argument("--no-baselines", action="store_true")
    given = parser.parse_args()
    lengths_s = () if given.no_outages else given.length or LENGTHS_S
    print_drives(given.data, given.drive, lengths_s, not given.no_baselines)


if __name__ == "__main__":
    main()
