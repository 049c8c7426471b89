"""`holdfast view`: a recording or the results of a replay in Rerun."""

from pathlib import Path
from types import ModuleType

import click

from holdfast.cli.progress import progress_bar
from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.output_folder import add_results, check_output_file


@click.command()
@click.argument("recording", type=click.Path())
@click.option("-o", "--output", metavar="FILE.rrd", help="Write a file for the viewer instead of opening it.")
@click.option("--connect", metavar="URL", help="Send it to a viewer that runs: rerun+http://HOST:9876/proxy.")
def view(recording: str, output: str | None, connect: str | None) -> None:
    """Show RECORDING in Rerun: a bag, a log of `holdfast live`, or the output folder of a replay.

    Draws tracks and fixes in space, the tree of frames, the covariance of the position (3 sigma), time series and
    events. Needs the extra viz.
    """
    if output is not None and connect is not None:
        raise ConfigError("--output and --connect: give only one of them")
    if output is not None and not output.endswith(".rrd"):
        raise ConfigError(f"--output {output}: must be a file *.rrd")
    if connect is not None:
        check_target("--connect", connect)
    path = Path(recording)
    if (path / "causal" / "estimates.mcap").is_file():
        path /= "causal"
        click.echo("note: the causal run is drawn, not the optimum over the recording", err=True)
    is_replay = (path / "estimates.mcap").is_file()
    if output is not None:
        check_output_file(output, [] if is_replay else [recording])
    show = drawing("holdfast view")
    from holdfast.recording.source import open_recording

    source = path / "estimates.mcap" if is_replay else path
    with open_recording(source) as opened:  # fails in one line if there is nothing to see
        begin_ns, end_ns = opened.start_ns, opened.end_ns
    target = output or connect or "window"
    sink = show.open_sink(target, path.name)
    with progress_bar("drawing", begin_ns, end_ns) as progress:
        show.draw_recording(path, sink, progress)
    show.close_sink(sink, target)
    if output is not None:
        add_results(Path(output))
        click.echo(f"written to {output}")


def check_target(option: str, target: str) -> None:
    """Refuse what no scene can be drawn to.

    Raises:
        ConfigError: names the option or the file.
    """
    if target != "window" and not target.endswith(".rrd") and not target.startswith("rerun+http"):
        raise ConfigError(f"{option} {target}: must be `window`, a file *.rrd or rerun+http://HOST:PORT/proxy")
    if target.endswith(".rrd"):
        check_output_file(target)


def drawing(command: str) -> ModuleType:
    """Return the module that draws.

    Raises:
        ConfigError: the extra is not installed.
    """
    with needing(command, "viz"):
        from holdfast.viz import show
    return show
