"""`holdfast demo`: 3.7 km of real driving, estimated and judged in a few seconds, without a download."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.cli.progress import progress_bar
from holdfast.cli.terminal import guarded_console
from holdfast.cli.writing import naming_the_output
from holdfast.errors import HoldfastError
from holdfast.output_folder import replaced

if TYPE_CHECKING:
    from holdfast.replay.runner import Replay

OUTAGE_S = (380.0, 440.0)
CONFIG = """\
# The KITTI drive that ships with gtsam (raw data 2011_10_03_0027): IMU and GNSS of an OXTS RT3003.
sensors:
  imu:
    kind: imu
    topic: /imu
    # the unit compensates its biases; its datasheet gives 2 deg/h, this allows 18 times as much
    gyroscope_bias_sigma: {value: 0.01, unit: deg/s}
    gyroscope_random_walk: 1e-6
  gnss:
    kind: gnss
    topic: /gnss/fix
    frame: imu              # the unit reports the position of its IMU
    time_offset_s: 0.059    # its GNSS stamps are that much early against the IMU's clock
"""


@click.command()
@click.option("-o", "--output", type=click.Path(), default="demo", show_default=True, help="Folder for the results.")
def demo(output: str) -> None:
    """Estimate 3.7 km of real driving; needs no download.

    Every second GNSS fix is held back to judge the estimate by it, and GNSS is cut for a minute.
    """
    from holdfast.api.session import Session, run
    from holdfast.cli.command_line import command_line
    from holdfast.config.load import parse_config
    from holdfast.recording.source import open_recording
    from holdfast.recording.subscriptions import subscriptions
    from holdfast.replay.held_out import HoldOut

    folder = Path(output)
    config = parse_config(CONFIG, "demo configuration")
    click.echo("Holdfast demo: KITTI drive 2011_10_03_0027, 470 s, 3.7 km through Karlsruhe, IMU 100 Hz, GNSS 1 Hz.")
    click.echo(
        "The IMU drops out eight times for 1.6 s (the file hides it under straight lines), the car drives from the\n"
        "first second on, and there is one antenna: heading comes from the motion. Every second fix is held back, and\n"
        f"GNSS is cut from {OUTAGE_S[0]:.0f} to {OUTAGE_S[1]:.0f} s: the estimate has the IMU alone then."
    )
    rules = [HoldOut("gnss", every=2), HoldOut("gnss", None, *OUTAGE_S)]
    with naming_the_output(output), replaced(output, "demo"):
        with open_recording("kitti") as recording:
            session = Session(
                path="kitti",
                config=config,
                folder=folder,
                messages=recording.read(subscriptions(config)),
                rules=rules,
                keep_track=True,
                command=command_line(),
            )
            done = run(session, recording, progress_bar("driving", recording.start_ns, recording.end_ns))
            done.check_end()
        summary = done.summary
        (folder / "config.yaml").write_text(CONFIG, encoding="utf-8")
        timing = summary["timing"]
        click.echo(f"\n{timing['recorded_s']:.0f} s of driving took {timing['wall_s']:.1f} s.")
        _print_table(done.run)
        _draw(done.run, folder / "track.png")
    click.echo(f"written to {folder}: trajectories (TUM), estimates.mcap, events.jsonl, summary.json, config.yaml")


def _print_table(run: "Replay") -> None:
    import numpy as np
    from rich.table import Table

    from holdfast.replay.summary import by_circumstance

    table = Table(title="Error at fixes that the estimator never saw, horizontal [m]", title_justify="left")
    for column in ("", "fixes", "RMS", "median", "p95", "max"):
        table.add_column(column, justify="left" if not column else "right")
    causal, smoothed = run.causal.judgements, run.smoothed.judgements
    silent = {judgement.stamp_ns for judgement in causal if judgement.imu_silent}
    parts = by_circumstance(causal, silent)
    rows = [
        ("as published, GNSS and IMU available", parts["nominal"]),
        ("  ... in the IMU's drop-outs (*)", parts["imu_gap"]),
        ("smoothed, 3 s later", by_circumstance(smoothed, silent)["nominal"]),
        ("in the outage, first 10 s", _first(causal, 10.0)),
        ("in the outage, whole minute", _first(causal, 60.0)),
        ("after it, first 10 s (**)", parts["recovery"]),
    ]
    for name, judgements in rows:
        if judgements:
            e = np.array([np.hypot(j.error[0], j.error[1]) for j in judgements])
            values = (np.sqrt(np.mean(e**2)), np.median(e), np.percentile(e, 95), e.max())
            table.add_row(name, str(len(e)), *(f"{value:.2f}" for value in values))
    guarded_console().print(table)
    click.echo("(*) the logger drew lines through the positions too: those fixes are no measurements.")
    click.echo("(**) two fixes, 2 s apart here, must agree with each other before GNSS is trusted again.")


def _first(judgements: list, seconds: float) -> list:  # type: ignore[type-arg]
    outage = [j for j in judgements if j.in_outage]
    return [j for j in outage if j.stamp_ns - outage[0].stamp_ns <= seconds * 1e9]


def _draw(run: "Replay", path: Path) -> None:
    from holdfast.report.track import draw_track

    track, start_ns = run.judged_track()
    first_ns = run.first_stamp_ns
    outages = [((first_ns - start_ns) * 1e-9 + OUTAGE_S[0], (first_ns - start_ns) * 1e-9 + OUTAGE_S[1])]
    try:
        draw_track(track, path, "KITTI drive, every second fix held out, GNSS cut for a minute", outages)
    except HoldfastError as error:
        click.echo(f"no figure: {error}", err=True)
    else:
        click.echo(f"figure of the track: {path}")
