"""`holdfast lidar-odometry`: a recording with point clouds in, the recording with poses in their place out."""

from pathlib import Path
from time import perf_counter

import click

from holdfast.cli.finite import FiniteRange
from holdfast.cli.progress import progress_bar
from holdfast.errors import ConfigError
from holdfast.output_folder import add_results, check_output_file, naming_the_output


@click.command("lidar-odometry")
@click.argument("bag", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="MCAP file to write.")
@click.option(
    "-c",
    "--config",
    "config_path",
    type=click.Path(),
    help="Predict and deskew with the IMU of this configuration; a `kind: scans` brings its settings.",
)
@click.option("--topic", help="Of the clouds. [default: the only PointCloud2]")
@click.option("--output-topic", default="/lidar/odometry", show_default=True, help="Of the poses.")
@click.option(
    "--method",
    type=click.Choice(["small-gicp", "genz-icp", "kiss-icp"]),
    default="small-gicp",
    show_default=True,
    help="Library that registers the clouds.",
)
@click.option(
    "--threads", type=click.IntRange(1, 64), default=1, show_default=True, help="More than 1 varies the bits."
)
@click.option(
    "--latency-s",
    type=FiniteRange(0, 10),
    default=0.08,
    show_default=True,
    help="Poses arrive so long after their cloud.",
)
@click.option(
    "--min-range-m", type=FiniteRange(0), default=1.0, show_default=True, help="Nearer points are the machine."
)
@click.option(
    "--machine-box",
    "machine_boxes",
    type=float,
    nargs=6,
    multiple=True,
    metavar="X Y Z X Y Z",
    help="Points between these corners, in the lidar's frame [m], are the machine; may be repeated.",
)
@click.option(
    "--learn-machine/--no-learn-machine",
    default=True,
    show_default=True,
    help="Learn from moving which points are the machine and its arm.",
)
@click.option("--keep-scans", is_flag=True, help="Copy the clouds too.")
@click.option("--replace", is_flag=True, help="Drop what BAG itself has on the output topic.")
@click.option("--force", is_flag=True, help="Overwrite the output.")
def lidar_odometry(  # noqa: PLR0917 (click passes the options by name)
    bag: Path,
    output: Path,
    config_path: str | None,
    topic: str | None,
    output_topic: str,
    method: str,
    threads: int,
    latency_s: float,
    min_range_m: float,
    machine_boxes: tuple[tuple[float, ...], ...],
    learn_machine: bool,
    keep_scans: bool,
    replace: bool,
    force: bool,
) -> None:
    """Estimate the lidar's motion from the clouds of BAG.

    Writes everything that BAG holds except its clouds, and nav_msgs/Odometry of the lidar: a recording for `holdfast
    replay`. BAG is a ROS 1 or ROS 2 bag, an .mcap or a .db3 file.
    """
    from holdfast.config.load import load_config
    from holdfast.lidar_odometry.masked import Masking, boxes_of
    from holdfast.lidar_odometry.registration import DEFAULT_METHOD, check_installed
    from holdfast.lidar_odometry.runner import Options, choose_topic, guide_of, run
    from holdfast.recording.mcap_writer import McapWriter
    from holdfast.recording.raw import RawBag
    from holdfast.ros.names import check_topic

    check_topic("--output-topic", output_topic)
    masking = Masking(boxes_of(machine_boxes), learn_machine)
    options = Options(topic, output_topic, method, threads, latency_s, min_range_m, keep_scans, replace, masking)
    if config_path is not None and method != DEFAULT_METHOD:
        raise ConfigError(f"--config: {method} takes no IMU (allowed: with {DEFAULT_METHOD})")
    check_installed(method)
    config = None if config_path is None else load_config(config_path)
    _check_output(output, bag, config_path, force)
    began_s = perf_counter()
    with RawBag(bag) as opened:
        chosen = choose_topic(opened, options)
        guide = None if config is None else guide_of(config, opened, options)
        begin_ns, end_ns = opened.recording.start_ns, opened.recording.end_ns
        with naming_the_output(output):
            with McapWriter(output) as writer, progress_bar("registering", begin_ns, end_ns) as progress:
                summary = run(opened, chosen, writer, options, guide, progress)
            add_results(output)
    for warning in summary.warnings:
        click.echo(f"warning: {warning}", err=True)
    milliseconds = (perf_counter() - began_s) / summary.poses * 1e3
    click.echo(f"{chosen} -> {output_topic}: {summary.poses} poses by {method}, {milliseconds:.0f} ms each")
    click.echo(
        f"{100 * summary.cut / summary.poses:.0f} % of the points lay on the machine; {summary.unheld} poses have "
        "directions that the scan does not hold, which their covariance tells"
    )
    click.echo(f"written to {output}")


def _check_output(output: Path, bag: Path, config_path: str | None, force: bool) -> None:
    if output.suffix != ".mcap":
        raise ConfigError(f"{output}: must end in .mcap")
    with naming_the_output(output):
        output.parent.mkdir(parents=True, exist_ok=True)
    check_output_file(output, [bag] if config_path is None else [bag, config_path])
    if output.exists() and not force:
        raise ConfigError(f"{output}: exists already: --force overwrites it")
