"""`holdfast report`: one HTML page about a replay, from the files that it wrote."""

from pathlib import Path

import click

from holdfast.extras import needing
from holdfast.output_folder import add_results, check_output_file


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    help="Poses of the IMU in the world to judge by: a TUM file, or the truth/ folder of a simulation.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="HTML file. [default: FOLDER/report.html]")
def report(folder: Path, reference: Path | None, output: Path | None) -> None:
    """Write a page about the replay whose results are in FOLDER.

    The page needs no network: the track on a map, errors if a reference is given, health and trust over time, every
    switch with its reason in words, outcomes of the measurements, the odometry frame, claimed deviations and latency.
    The same numbers are written beside it as JSON.
    """
    with needing("a report", "report"):
        import plotly  # noqa: F401
    from holdfast.replay.results import read_run
    from holdfast.report.page import page_file, write_page
    from holdfast.report.single_run import single_run_page

    file = page_file(folder / "report.html" if output is None else output, "--output ")
    run = read_run(folder, reference)
    for written in (file, file.with_suffix(".json")):
        check_output_file(written, [] if reference is None else [reference])
    write_page(single_run_page(run), file)
    add_results(file, file.with_suffix(".json"))
    click.echo(f"written to {file} and {file.with_suffix('.json').name}")
