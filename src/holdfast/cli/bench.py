"""`holdfast bench`: how fast the estimator is on this machine, and whether it has become slower."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from holdfast.cli.bench_realtime import realtime
from holdfast.cli.progress import progress_bar
from holdfast.cli.replay import check_window
from holdfast.cli.terminal import guarded_console
from holdfast.cli.writing import write_json
from holdfast.errors import ConfigError, HoldfastError
from holdfast.output_folder import check_output_file

if TYPE_CHECKING:
    from holdfast.config.model import Config
    from holdfast.recording.source import Recording

BASELINE = "benchmarks/baseline.json"


@click.group(invoke_without_command=True)
@click.option("--recording", default="kitti", show_default=True, help="What to replay; `kitti` ships with gtsam.")
@click.option("-c", "--config", "config_path", type=click.Path(), help="Configuration. [default: that of kitti]")
@click.option("--nodes", type=click.Choice(["measurement", "imu", "both"]), help="[default: as configured]")
@click.option("--duration", "duration_s", type=float, metavar="SECONDS", help="Replay only this much.")
@click.option("--json", "json_path", type=click.Path(), help="Write the result for machines.")
@click.option("--gate", type=click.Path(), help=f"Exit 1 if slower than this baseline, such as {BASELINE}.")
@click.option("--update-baseline", is_flag=True, help=f"Write the baseline: the file of --gate, or {BASELINE}.")
@click.pass_context
def bench(  # noqa: PLR0917 (click passes the options by name)
    context: click.Context,
    recording: str,
    config_path: str | None,
    nodes: str | None,
    duration_s: float | None,
    json_path: str | None,
    gate: str | None,
    update_baseline: bool,
) -> None:
    """Measure speed on this machine.

    Replays a recording, without and with writing the results, each time in a process of its own. The floor is a bare
    loop in which GTSAM propagates the same IMU samples, measured in the same process: ratios to it do not depend on the
    machine, and --gate compares them with those of a baseline.

    `holdfast bench realtime` measures the engine of two processes instead.
    """
    if context.invoked_subcommand is not None:
        return
    from holdfast.bench.replay import compare, describe_machine, read_baseline
    from holdfast.recording.source import open_recording

    check_window(0.0, duration_s)
    config = _configuration(recording, config_path)
    baseline = read_baseline(gate) if gate and not update_baseline else None
    for path in (json_path, (gate or BASELINE) if update_baseline else None):
        if path is not None:
            check_output_file(path, [recording] if config_path is None else [recording, config_path])
    with open_recording(recording) as opened:
        runs = dict(_run_all(opened, recording, config, nodes or config.graph.nodes, duration_s))
    result = {"recording": recording, "duration_s": duration_s, "machine": describe_machine(), "runs": runs}
    _print(result)
    if json_path is not None:
        write_json(json_path, result)
    if update_baseline:
        _update(gate or BASELINE, result)
    if baseline is not None:
        slower = compare(result, baseline, str(gate))
        if slower:
            raise HoldfastError("\n".join(slower))
        click.echo(f"not slower than {gate}")


bench.add_command(realtime)


def _configuration(recording: str, path: str | None) -> "Config":
    from holdfast.config.load import load_config, parse_config

    if path is not None:
        return load_config(path)
    if recording != "kitti":
        raise ConfigError(f"--recording {recording}: needs a configuration: give -c")
    from holdfast.cli.demo import CONFIG

    return parse_config(CONFIG, "demo configuration")


def _run_all(
    opened: "Recording", recording: str, config: "Config", nodes: str, duration_s: float | None
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the kind of nodes and its result; a replay that writes is measured as well."""
    from holdfast.bench.replay import Job, measure
    from holdfast.recording.subscriptions import subscriptions

    wanted = tuple(subscriptions(config))
    opened.read(wanted, 0.0, duration_s)  # refuses a wrong topic before a process is started
    end_ns = opened.end_ns
    if end_ns is not None and opened.start_ns is not None and duration_s is not None:
        end_ns = min(end_ns, opened.start_ns + round(duration_s * 1e9))
    kinds: tuple[Literal["measurement", "imu"], ...] = ("measurement", "imu")
    for kind in kinds:
        if nodes not in {kind, "both"}:
            continue
        chosen = config.model_copy(update={"graph": config.graph.model_copy(update={"nodes": kind})})
        with progress_bar(f"nodes {kind}", opened.start_ns, end_ns) as progress:
            result = measure(Job(recording, chosen, wanted, duration_s), progress)
        with progress_bar(f"nodes {kind}, writing", opened.start_ns, end_ns) as progress:
            writing = measure(Job(recording, chosen, wanted, duration_s, with_outputs=True), progress)
        yield (
            kind,
            result | {"with_outputs": {key: writing[key] for key in ("timing", "cpu_s", "peak_memory_mb", "ratios")}},
        )


def _print(result: dict[str, Any]) -> None:
    from rich import box
    from rich.table import Table

    from holdfast.bench.replay import RATIOS

    machine, runs = result["machine"], result["runs"]
    plain = not sys.stdout.isatty()
    console = guarded_console(highlight=False, markup=False, width=120 if plain else None)
    console.print(f"{machine['cpu']}, {machine['cores']} cores, Python {machine['python']}, gtsam {machine['gtsam']}")
    recorded = next(iter(runs.values()))["timing"]["recorded_s"]
    console.print(f"{result['recording']}: {recorded:.1f} s recorded")
    table = Table(box=None if plain else box.SIMPLE_HEAD, pad_edge=not plain)
    table.add_column("")
    for name in runs:
        table.add_column(f"nodes: {name}", justify="right")
    rows: list[tuple[str, list[str]]] = [
        ("real-time factor", [f"{run['timing']['real_time_factor']:.0f}" for run in runs.values()]),
        (
            "real-time factor, writing the results",
            [f"{run['with_outputs']['timing']['real_time_factor']:.0f}" for run in runs.values()],
        ),
    ]
    columns = ("median", "p90", "p99", "max")
    for key, title, digits in (("imu_us", "IMU sample to estimate [us]", 1), ("update_ms", "update [ms]", 2)):
        for column in columns:
            found = [run["timing"][key] for run in runs.values()]  # None where nothing was timed
            cells = ["-" if one is None else f"{one[column]:.{digits}f}" for one in found]
            rows.append((f"{title}, {column}", cells))
    rows.append(
        ("floor: GTSAM alone, per sample [us], median", [f"{run['floor_us']['median']:.1f}" for run in runs.values()])
    )
    rows += [(meaning, [f"{run['ratios'][name]:.2f}" for run in runs.values()]) for name, meaning in RATIOS.items()]
    cells = [f"{run['with_outputs']['ratios']['cpu']:.2f}" for run in runs.values()]
    rows.append((f"{RATIOS['cpu']}, writing the results", cells))
    rows.append(("peak memory [MB]", [f"{run['peak_memory_mb']:.0f}" for run in runs.values()]))
    rows.append(
        ("peak memory, writing [MB]", [f"{run['with_outputs']['peak_memory_mb']:.0f}" for run in runs.values()])
    )
    for title, cells in rows:
        table.add_row(title, *cells)
    console.print(table)


def _update(path: str, result: dict[str, Any]) -> None:
    """Write the baseline; a bound that someone has set in it is kept."""
    from holdfast.bench.replay import MAX_FACTOR, make_baseline, read_baseline

    max_factor = float(read_baseline(path)["max_factor"]) if Path(path).exists() else MAX_FACTOR
    write_json(path, make_baseline(result, max_factor))
    click.echo(f"baseline written to {path}")
