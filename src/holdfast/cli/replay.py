"""`holdfast replay`: a recording in, trajectories, ROS messages, events and a summary out."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from holdfast.cli.learnt import learnt_option
from holdfast.cli.progress import reading_bar
from holdfast.errors import ConfigError
from holdfast.output_folder import naming_the_output, replaced
from holdfast.parent import end_with_parent

if TYPE_CHECKING:
    from holdfast.config.model import Config
    from holdfast.recording.source import Recording, Subscription
    from holdfast.replay.held_out import HoldOut

SLOWEST_RATE = 1e-6


@click.command()
@click.argument("recording", type=click.Path())
@click.option(
    "-c", "--config", "config_path", type=click.Path(), help="Configuration (YAML). Without it one is guessed, aloud."
)
@click.option("-o", "--output", required=True, type=click.Path(), help="Folder for the results.")
@click.option("--start", "start_s", type=float, default=0.0, metavar="SECONDS", help="Skip the beginning.")
@click.option("--duration", "duration_s", type=float, metavar="SECONDS", help="Replay only this much.")
@click.option("--rate", type=float, metavar="FACTOR", help="Pace: 1 is that of the recording. [default: all out]")
@click.option("--realtime", is_flag=True, help="At the pace of the recording, through the engine of two processes.")
@click.option("--hold-out", multiple=True, metavar="SENSOR=N", help="Hold back every N-th message, to judge by it.")
@click.option("--outage", multiple=True, metavar="SENSOR=START:END", help="Hold back all messages of this time [s].")
@learnt_option
@click.option("--strict", is_flag=True, help="Refuse a recording that lacks a sensor of the configuration.")
@click.option("--child", is_flag=True, hidden=True, help="Of `batch`: the folder is ready; end with standard input.")
def replay(  # noqa: PLR0917 (click passes the options by name)
    recording: str,
    config_path: str | None,
    output: str,
    start_s: float,
    duration_s: float | None,
    rate: float | None,
    realtime: bool,
    hold_out: tuple[str, ...],
    outage: tuple[str, ...],
    learnt_path: str | None,
    strict: bool,
    child: bool,
) -> None:
    """Estimate the trajectory of RECORDING.

    Writes to the output folder: imu_in_world.tum and imu_in_odom.tum (what was published at each IMU sample; base_*.tum
    if the extrinsics reach the base), optimized_in_world.tum (newest node after each update), smoothed_in_world.tum
    (each node as it leaves the window), estimates.mcap, events.jsonl and summary.json. The folder is replaced as a
    whole; one that holds anything else is refused.

    Sensors of which RECORDING holds nothing are missed with a warning, except the primary IMU and the last position.

    With --realtime the recording plays as it would live: samples of the IMU are answered while another process
    optimises. What comes out depends a little on how busy this machine is.

    With --hold-out gnss=2 every second fix is kept from the estimator and the estimate is judged by it.

    Without -c the configuration is what `holdfast config init` can tell of the recording, less the sensors whose mounts
    it does not hold. What was assumed is told, and guessed_config.yaml in the output folder is a file to go on from.
    """
    from holdfast.api.session import Session, run
    from holdfast.calibration.learnt_file import check_learnt_file
    from holdfast.cli.command_line import command_line
    from holdfast.cli.guessed import FILE, guessed_config
    from holdfast.config.load import load_config
    from holdfast.config.review import check_possible
    from holdfast.recording.source import open_recording

    if child:
        end_with_parent()
    check_window(start_s, duration_s, rate)
    config = None if config_path is None else check_possible(load_config(config_path), config_path)
    reads = [recording] if config_path is None else [recording, config_path]
    if learnt_path is not None:
        check_learnt_file(learnt_path, output, reads)
    folder = nullcontext() if child else replaced(output, "replay", reads)
    with open_recording(recording) as opened, naming_the_output(output):
        guess = None
        if config is None:
            guess = guessed_config(opened, output)
            config = guess.config
        rules = rules_of(hold_out, outage, config)  # before the results of an earlier replay are overwritten
        wanted, missing = wanted_of(opened, config, strict)
        session = Session(
            path=recording,
            config=config,
            folder=Path(output),
            messages=opened.read(wanted, start_s, duration_s),
            missing=missing,
            rules=rules,
            rate=rate,
            realtime=realtime,
            learnt=None if learnt_path is None else Path(learnt_path),
            command=command_line(),
        )
        with folder:
            if guess is not None:
                (session.folder / FILE).write_text(guess.text, encoding="utf-8")
            done = run(session, opened, reading_bar("replaying", opened, start_s, duration_s))
            for warning in done.warnings:
                click.echo(f"warning: {warning}", err=True)
            done.check_end()
    done.check_start(session)
    print_summary(done.summary, output)


def wanted_of(opened: "Recording", config: "Config", strict: bool) -> "tuple[list[Subscription], dict[str, str]]":
    """Return what the recording can serve, and for each sensor that is missing the reason, after a warning.

    Raises:
        RecordingError: `strict`, or a sensor without which nothing can be estimated is missing.
    """
    from holdfast.recording.subscriptions import available, subscriptions

    if strict:
        return subscriptions(config), {}
    wanted, missing = available(opened, config)
    for sensor, reason in missing.items():
        click.echo(f"warning: {sensor}: {reason}: the estimate does without it (--strict refuses)", err=True)
    return wanted, missing


def rules_of(hold_out: Sequence[str], outage: Sequence[str], config: "Config") -> "list[HoldOut]":
    """Return what is to be held back, as the options say.

    Raises:
        ConfigError: names the option, or the sensor that is not there.
    """
    from holdfast.replay.held_out import HoldOut, check_sensors

    rules = [HoldOut.parse_every(text) for text in hold_out] + [HoldOut.parse_outage(text) for text in outage]
    check_sensors(rules, config)
    return rules


def check_window(start_s: float, duration_s: float | None, rate: float | None = None) -> None:
    """Refuse a window, or a rate, at which nothing can be replayed.

    Raises:
        ConfigError: names the option.
    """
    from holdfast.recording.source import LONGEST_S

    if not 0 <= start_s <= LONGEST_S:
        raise ConfigError(f"--start {start_s:g}: must be >= 0 and <= {LONGEST_S:g}")
    if duration_s is not None and not 0 < duration_s <= LONGEST_S:
        raise ConfigError(f"--duration {duration_s:g}: must be > 0 and <= {LONGEST_S:g}")
    if rate is not None and not SLOWEST_RATE <= rate < inf:
        raise ConfigError(f"--rate {rate:g}: must be > 0, at least {SLOWEST_RATE:g}, and finite")


def timing_line(timing: Mapping[str, Any]) -> str:
    """Return how long it took, and one message as far as any was timed: a short run may complete no update."""
    factor = timing["real_time_factor"]
    pace = "" if factor is None else f" ({factor:.0f} x real time)"
    parts = [f"{timing['recorded_s']:.0f} s in {timing['wall_s']:.1f} s{pace}"]
    if timing["imu_us"] is not None:
        parts.append(f"IMU sample {timing['imu_us']['median']:.0f} us")
    if timing["update_ms"] is not None:
        parts.append(f"update {timing['update_ms']['median']:.1f} ms")
    return ", ".join(parts) + (" (medians)" if len(parts) > 1 else "")


def print_summary(summary: dict[str, Any], output: str) -> None:
    """Print what a user wants to know first: was it used, how good, how fast, where."""
    click.echo(timing_line(summary["timing"]))
    for sensor, outcomes in summary["counts"].items():
        click.echo(f"  {sensor:10s} " + ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()))
    for sensor, reason in summary["missing"].items():
        click.echo(f"  {sensor:10s} missing: {reason}")
    for track, parts in summary["held_out"].items():
        for part, errors in (parts or {}).items():
            horizontal, vertical, nees = errors["horizontal_m"], errors["vertical_m"], errors["nees_per_dof"]
            line = f"  held out, {track:8s} {part:8s} {horizontal['count']:5d} fixes: horizontal RMS"
            line += f" {horizontal['rms']:.3f} m, p95 {horizontal['p95']:.3f} m, max {horizontal['max']:.3f} m"
            line += f"; vertical RMS {vertical['rms']:.3f} m"
            click.echo(line + ("" if nees is None else f"; NEES/3 {nees:.2f}"))
    for line in summary["looks_wrong"]:
        click.echo(f"  {line}")
    click.echo(f"written to {output}")
