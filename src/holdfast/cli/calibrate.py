"""`holdfast calibrate`: recordings and a configuration in, a configuration that fits them out."""

from contextlib import AbstractContextManager
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.cli.progress import reading_bar
from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.output_folder import check_output_file
from holdfast.whole_file import write_whole

if TYPE_CHECKING:
    from holdfast.calibration.calibrate import Calibration
    from holdfast.calibration.evidence import Progress
    from holdfast.recording.source import Recording


@click.command()
@click.argument("recordings", nargs=-1, required=True, metavar="RECORDING...", type=click.Path())
@click.option("-c", "--config", "config_path", required=True, type=click.Path(), help="Configuration (YAML).")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Configuration to be written.")
@click.option("--lever-arms", is_flag=True, help="Estimate the lever arms of the antennas, too.")
@click.option(
    "--hold-out", "every", type=int, default=10, show_default=True, metavar="N", help="Judge by every N-th fix."
)
@click.option("--no-page", is_flag=True, help="Write no page beside the configuration.")
@click.option("--force", is_flag=True, help="Overwrite the output if it exists.")
def calibrate(  # noqa: PLR0917 (click passes the options by name)
    recordings: tuple[str, ...],
    config_path: str,
    output: Path,
    lever_arms: bool,
    every: int,
    no_page: bool,
    force: bool,
) -> None:
    """Find from RECORDINGS of one machine what its sensors are, and write it into a copy of its configuration.

    Time offsets, rotations of odometries, the zero of the turn joint's encoder, noise and drift: each number with its
    sigma. What cannot be observed keeps what the file says, and so does what makes held-out fixes worse, or what they
    could not judge before Ctrl-C. Comments, order and layout of the file stay. A page beside the output (OUTPUT.html,
    and its numbers as .json) shows every number before and after.
    """
    from holdfast.calibration.calibrate import calibrated

    page = None if no_page else output.with_suffix(".html")
    _check(output, page, (*recordings, config_path), every, force)

    def watch(title: str, opened: "Recording") -> "AbstractContextManager[Progress]":
        return reading_bar(f"{title}, {opened.path.name}", opened)

    found = calibrated(recordings, config_path, with_lever_arms=lever_arms, every=every, watch=watch)
    write_whole(output, found.text)
    if page is not None:
        from holdfast.calibration.page import calibration_page
        from holdfast.report.page import write_page

        options = " --lever-arms" * lever_arms + f" --hold-out {every}" * (every != 10)
        command = f"holdfast calibrate {' '.join(recordings)} -c {config_path} -o {output}{options}"
        write_page(calibration_page(found, command), page)
    _print(found)
    click.echo(f"written to {output}" + (f", {page.name} and {page.with_suffix('.json').name}" if page else ""))
    if isinstance(found.failure, KeyboardInterrupt):
        raise KeyboardInterrupt(f"what was found until then is in {output}")
    if found.failure is not None:
        raise found.failure


def _check(output: Path, page: Path | None, reads: tuple[str, ...], every: int, force: bool) -> None:
    """Refuse before long work what would be refused after it."""
    if every < 2:
        raise ConfigError(f"--hold-out {every}: must be an integer >= 2")
    if output.suffix.lower() not in (".yaml", ".yml"):
        raise ConfigError(f"--output {output}: the name must end in .yaml")
    for file in (output, *([page, page.with_suffix(".json")] if page else [])):
        check_output_file(file, reads)
        if file.exists() and not force:
            raise ConfigError(f"{file}: exists already: give another name, or --force to overwrite it")
    if page is not None:
        with needing("the page", "report"):
            import plotly  # noqa: F401


def _print(found: "Calibration") -> None:
    """Print what is written, and what is not and why."""
    from holdfast.calibration.calibrate import UNJUDGED

    for one in found.estimates:
        if one.is_written or one.reason == UNJUDGED:
            but = "" if one.is_written else ", not written"
            values = f"{one.before:.4g} -> {one.after:.4g} {one.unit}, sigma {one.sigma:.2g}{but}"
            click.echo(f"{one.key}: {one.what}: {values}")
    for reason in dict.fromkeys(one.reason for one in found.estimates if not one.is_written):
        names = [f"{one.what} ({one.path[-1]})" for one in found.estimates if one.reason == reason]
        click.echo(f"kept, {reason}: {', '.join(names)}")
    for held in found.held_out:
        outage = held.rms(in_outage=True)
        lost = f", in cut outages {outage * 1e3:.1f} mm" if isfinite(outage) else ""
        click.echo(f"held out, {held.label}: horizontal RMS {held.rms(in_outage=False) * 1e3:.1f} mm{lost}")
