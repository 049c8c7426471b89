"""`holdfast config`: start, check, upgrade and describe configuration files."""

from pathlib import Path

import click

from holdfast.errors import ConfigError
from holdfast.output_folder import check_folder_of, check_output_file
from holdfast.whole_file import write_whole


@click.group()
def config() -> None:
    """Start, check, upgrade and describe configuration files."""


@config.command()
@click.argument("file", type=click.Path(path_type=Path))
def check(file: Path) -> None:
    """Check FILE and show what it comes to; every mistake is listed with its line."""
    from holdfast.config.load import load_config
    from holdfast.config.review import check_possible, sensor_rows, warnings

    loaded = check_possible(load_config(file), str(file))
    click.echo(f"{file}: ok")
    rows = [("sensor", "topic", "frame", "lever arm")]
    for row in sensor_rows(loaded):
        lever_arm = "-" if row.lever_arm_m is None else f"{row.lever_arm_m:.3f} m"
        rows.append((row.sensor, row.topic, row.frame or "-", lever_arm))
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    for cells in rows:
        click.echo("  " + "  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())
    frames = loaded.frames
    datum = "first accepted fix" if frames.datum is None else ", ".join(f"{v}" for _, v in frames.datum)
    click.echo(f"  publishes {frames.world} -> {frames.odometry}, datum: {datum}")
    for warning in warnings(loaded):
        click.echo(f"warning: {warning}")


@config.command()
def schema() -> None:
    """Print the JSON schema of the file, for editors that complete and check YAML."""
    import json

    from holdfast.config.reference import editor_schema

    click.echo(json.dumps(editor_schema(), indent=2, ensure_ascii=False))


@config.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Write to this file instead of the screen.")
@click.option("--minimal", is_flag=True, help="Only what differs from the defaults: a line per sensor and per mount.")
@click.option("--force", is_flag=True, help="Overwrite the file if it exists.")
def init(recording: Path, output: Path | None, minimal: bool, force: bool) -> None:
    """Write a commented configuration for RECORDING, guessing which topic is which sensor.

    Its first two minutes are read: rates, latencies, the IMU at its quietest and the claims of the receivers stand
    beside the keys. So do the clocks of the receivers against the IMU, of up to five minutes. Mounts are those of
    /tf_static and of what stays the same on /tf, by the frame_id of the messages; others are marked TODO.
    """
    from holdfast.cli.progress import reading_bar
    from holdfast.config.starter import minimal_yaml, starter_yaml
    from holdfast.recording.first_config import LOOKED_AT_S, first_proposal
    from holdfast.recording.source import open_recording

    _check_output(output, force)
    if output is not None and output.exists():  # a new one may lie in the recording's folder
        check_output_file(output, [recording])
    with open_recording(recording) as opened, reading_bar("reading", opened, 0.0, LOOKED_AT_S) as progress:
        proposal = first_proposal(opened, progress)
    text = minimal_yaml(proposal) if minimal else starter_yaml(proposal)
    for warning in proposal.all_warnings:
        click.echo(f"warning: {warning}", err=True)
    if output is None:
        click.echo(text, nl=False)
        return
    write_whole(output, text)
    todo = "measure what is marked TODO, then run" if "TODO" in text else "nothing is left to measure; now run"
    click.echo(f"{output}: written; {todo} `holdfast config check {output}`")


@config.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Write to this file instead of the screen.")
@click.option("--in-place", is_flag=True, help="Write to FILE itself.")
@click.option("--force", is_flag=True, help="Overwrite the output if it exists.")
def upgrade(file: Path, output: Path | None, in_place: bool, force: bool) -> None:
    """Rewrite FILE, of version 0.1, in the form of now; its comments and its layout stay."""
    from holdfast.config.load import STARTER, read_yaml
    from holdfast.config.upgrade import upgraded

    if in_place and output is not None:
        raise ConfigError("--in-place: cannot be given together with --output")
    _check_output(output, force)
    text, changes = upgraded(read_yaml(file, STARTER), str(file))
    for change in changes:
        click.echo(f"{file}: {change}", err=True)
    if not changes:
        click.echo(f"{file}: is of the form of now, nothing to change", err=True)
    destination = file if in_place and changes else output
    if destination is not None:
        write_whole(destination, text)
        click.echo(f"{destination}: written", err=True)
    elif not in_place:
        click.echo(text, nl=False)


def _check_output(output: Path | None, force: bool) -> None:
    if output is None:
        return
    check_folder_of(output)
    if output.exists() and not force:
        raise ConfigError(f"{output}: exists already: give another name, or --force to overwrite it")
