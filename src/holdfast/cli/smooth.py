"""`holdfast smooth`: a recording in, the best trajectory of the whole of it out, with covariance."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from holdfast.cli.progress import reading_bar
from holdfast.cli.replay import check_window, print_summary, rules_of, wanted_of
from holdfast.output_folder import naming_the_output, replaced

if TYPE_CHECKING:
    from holdfast.replay.runner import Replay


@click.command()
@click.argument("recording", type=click.Path())
@click.option("-c", "--config", "config_path", required=True, type=click.Path(), help="Configuration (YAML).")
@click.option("-o", "--output", required=True, type=click.Path(), help="Folder for the results.")
@click.option("--start", "start_s", type=float, default=0.0, metavar="SECONDS", help="Skip the beginning.")
@click.option("--duration", "duration_s", type=float, metavar="SECONDS", help="Take only this much.")
@click.option("--hold-out", multiple=True, metavar="SENSOR=N", help="Hold back every N-th message, to judge by it.")
@click.option("--outage", multiple=True, metavar="SENSOR=START:END", help="Hold back all messages of this time [s].")
@click.option("--strict", is_flag=True, help="Refuse a recording that lacks a sensor of the configuration.")
@click.option("--window", "window_s", type=float, default=300.0, show_default=True, help="Solved at once [s].")
@click.option("--overlap", "overlap_s", type=float, default=120.0, show_default=True, help="And what follows it [s].")
def smooth(  # noqa: PLR0917 (click passes the options by name)
    recording: str,
    config_path: str,
    output: str,
    start_s: float,
    duration_s: float | None,
    hold_out: tuple[str, ...],
    outage: tuple[str, ...],
    strict: bool,
    window_s: float,
    overlap_s: float,
) -> None:
    """Estimate the best trajectory of RECORDING: each state from all that was measured before and after it.

    Writes to the output folder: imu_in_world.tum and base_in_world.tum (at each sample of the IMU),
    imu_in_world.covariance.csv (at each node), biases.csv, refused.csv (which measurements weigh less than they claim)
    and summary.json; in causal/ what `holdfast replay` writes, of the run from which it starts.

    A window and what follows it are solved together, then the next window begins with all that is known: memory does
    not grow with the recording.
    """
    from holdfast.api.session import Session, run
    from holdfast.cli.command_line import command_line
    from holdfast.config.load import load_config
    from holdfast.config.review import check_possible
    from holdfast.recording.source import open_recording

    check_window(start_s, duration_s)
    from holdfast.smoothing.batch_smoother import check_lengths

    check_lengths(window_s, overlap_s, ("--window", "--overlap"))
    config = check_possible(load_config(config_path), config_path)
    rules = rules_of(hold_out, outage, config)
    with open_recording(recording) as opened, naming_the_output(output):
        wanted, missing = wanted_of(opened, config, strict)
        session = Session(
            path=recording,
            config=config,
            folder=Path(output),
            messages=opened.read(wanted, start_s, duration_s),
            missing=missing,
            rules=rules,
            batch_s=(window_s, overlap_s),
            command=command_line(),
        )
        with replaced(output, "smooth", (recording, config_path)):
            done = run(session, opened, reading_bar("smoothing", opened, start_s, duration_s))
            for warning in done.warnings:
                click.echo(f"warning: {warning}", err=True)
            done.check_end()
    done.check_start(session)
    print_summary(done.summary, output)
    _print_smooth(done.summary["smooth"], done.run)


def _print_smooth(found: dict[str, Any], run: "Replay") -> None:
    """Print what became of the measurements, and what the optimum cost."""
    number = len(found["windows"])
    windows = f"{number} window{'s' * (number > 1)}"
    click.echo(
        f"optimum: cost {found['cost']:.4g} after {found['iterations']} iterations in {windows}, "
        f"{found['wall_s']:.1f} s of {run.timing.wall_s:.1f} s"
    )
    if found["loop_closures"]:
        closures = ", ".join(f"{count} {what}" for what, count in found["loop_closures"].items())
        click.echo(f"  loop closures: {closures}")
    for sensor, outcomes in found["counts"].items():
        click.echo(f"  {sensor:10s} " + ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()))
