"""The results of a batch in one table: a row per job, from the summaries of the replays."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from holdfast.errors import HoldfastError
from holdfast.fleet.plan import Job
from holdfast.fleet.run import Outcome
from holdfast.replay.summary_file import read_summary
from holdfast.whole_file import whole

TABLE = "results.csv"
TIMES = ("median", "p99")
EVENTS = ("gnss_lost", "gnss_regained", "recovery_refused", "imu_gap", "optimiser_fault", "late", "rejected")
ERRORS = ("horizontal_m", "vertical_m", "yaw_deg")

Row = dict[str, str | float | int]


def rows_of(jobs: Sequence[Job], outcomes: Mapping[str, Outcome]) -> list[Row]:
    """Return a row per job, in their order; what is not known is left out of it."""
    return [_row(job, outcomes[job.name]) for job in jobs]


def write_table(rows: Sequence[Row], folder: Path) -> Path:
    """Write results.csv in one step, and return its path; what a row does not have is an empty cell."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    order = {key: index for index, key in enumerate(_fixed_columns())}
    columns.sort(key=lambda key: order.get(key, order["state"] - 0.5))
    file = folder / TABLE
    with whole(file) as part, part.open("w", newline="", encoding="utf-8", errors="backslashreplace") as stream:
        writer = csv.DictWriter(stream, columns, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {key: f"{value:.9g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows
        )
    return file


def _fixed_columns() -> list[str]:
    fixed = ["run", "recording", "state", "reason", "wall_s", *(f"{name}_rms" for name in ERRORS)]
    fixed += [f"held_out_{name}_rms" for name in ERRORS[:2]]
    fixed += ["recorded_s", "real_time_factor", "nominal_percent"]
    fixed += [f"{part}_{time}" for part in ("imu_us", "update_ms") for time in TIMES]
    return [*fixed, *EVENTS]


def _row(job: Job, outcome: Outcome) -> Row:
    row: Row = {"run": job.name, "recording": str(job.recording)}
    row |= dict(job.changes)
    row |= {"state": outcome.state, "reason": outcome.reason}
    if outcome.state == "done":
        row["wall_s"] = outcome.wall_s
        row |= {f"{name}_rms": rms for name, rms in outcome.errors.items()}
        row |= _of_summary(job.folder)
    return row


def _of_summary(folder: Path) -> Row:
    try:
        summary = read_summary(folder)
    except HoldfastError:
        return {}
    timing, health = summary["timing"], summary["health"]
    row: Row = {"recorded_s": timing["recorded_s"], "real_time_factor": timing["real_time_factor"] or 0.0}
    held_out = (summary["held_out"]["causal"] or {}).get("all")
    if held_out is not None:
        row |= {f"held_out_{name}_rms": held_out[name]["rms"] for name in ERRORS[:2]}
    row["nominal_percent"] = 100.0 * health.get("nominal", 0) / max(sum(health.values()), 1)
    for part in ("imu_us", "update_ms"):
        row |= {f"{part}_{time}": timing[part][time] for time in TIMES if timing[part]}
    return row | {name: summary["events"].get(name, 0) for name in EVENTS}
