"""`holdfast demo`: 3.7 km of real driving, estimated and judged in a few seconds, without a download."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from holdfast.cli.columns import aligned
from holdfast.cli.progress import progress_bar
from holdfast.errors import HoldfastError
from holdfast.output_folder import naming_the_output, replaced

if TYPE_CHECKING:
    from holdfast.replay.runner import Replay

OUTAGE_S = (380.0, 440.0)
EARLY_S = 10.0
SHOWN = 6  # columns for which a terminal has room
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
        print_errors(summary)
        click.echo(_early(done.run))
        _draw(done.run, folder / "track.png")
    click.echo(f"written to {folder}: trajectories (TUM), estimates.mcap, events.jsonl, summary.json, config.yaml")


def print_errors(summary: Mapping[str, Any]) -> None:
    """Print the errors at held-out fixes, as the report has them."""
    from holdfast.report.held_out import COLUMNS, held_out_rows, tracks_in_words
    from holdfast.report.page import shown

    click.echo("Errors at fixes that the estimator never saw:")
    for line in aligned([row[:SHOWN] for row in (COLUMNS, *(list(map(shown, row)) for row in held_out_rows(summary)))]):
        click.echo(f"  {line}")
    click.echo(tracks_in_words(summary))
    click.echo("imu_gap: the logger drew lines through the positions too: those fixes are no measurements.")
    click.echo("recovery: 10 s after the outage; two fixes, 2 s apart here, must agree before GNSS is trusted again.")


def _early(run: "Replay") -> str:
    """Return how good the estimate was when the outage had just begun."""
    import numpy as np

    outage = [one for one in run.causal.judgements if one.in_outage]
    errors = [np.hypot(*one.error[:2]) for one in outage if one.stamp_ns - outage[0].stamp_ns <= EARLY_S * 1e9]
    return f"In the first {EARLY_S:.0f} s of the outage the causal track is off by {max(errors):.2f} m at most."


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
