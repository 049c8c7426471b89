"""`holdfast config`: start, check and describe configuration files."""

from pathlib import Path

import click

from holdfast.cli.writing import naming_the_output
from holdfast.errors import ConfigError


@click.group()
def config() -> None:
    """Start, check and describe configuration files."""


@config.command()
@click.argument("file", type=click.Path(path_type=Path))
def check(file: Path) -> None:
    """Check FILE and show what it comes to; every mistake is listed with its line."""
    from holdfast.config.load import load_config
    from holdfast.config.review import sensor_rows, warnings

    loaded = load_config(file)
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
@click.option("--force", is_flag=True, help="Overwrite the file if it exists.")
def init(recording: Path, output: Path | None, force: bool) -> None:
    """Write a commented configuration for RECORDING, guessing which topic is which sensor."""
    from holdfast.config.starter import starter_yaml
    from holdfast.recording.decode import DECODERS
    from holdfast.recording.source import open_recording

    if output is not None and output.exists() and not force:
        raise ConfigError(f"{output}: exists already: give another name, or --force to overwrite it")
    with open_recording(recording) as opened:
        text = starter_yaml(str(recording), opened.topics, {kind: tuple(types) for kind, types in DECODERS.items()})
    if output is None:
        click.echo(text, nl=False)
        return
    with naming_the_output(output):
        output.write_text(text, encoding="utf-8")
    click.echo(f"{output}: written; measure what is marked TODO, then run `holdfast config check {output}`")
