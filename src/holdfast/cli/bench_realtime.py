"""`holdfast bench realtime`: how fast the IMU path answers while another process optimises."""

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from holdfast.cli.finite import FiniteRange
from holdfast.cli.progress import progress_bar
from holdfast.cli.replay import check_window
from holdfast.cli.terminal import guarded_console
from holdfast.cli.writing import write_json
from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.output_folder import check_output_file

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from holdfast.bench.realtime import Pace
    from holdfast.config.model import Config
    from holdfast.messages import Message

MAX_RATIO = 1.0  # to the floor of the same run
COLUMNS = ("mean", "std", "median", "p99", "p99.9", "max")
TITLES = {
    "busy": "optimiser busy",
    "idle": "optimiser idle",
    "cabin_only": "optimiser busy, without the chassis",
    "back_to_back": "back to back",
}


@click.command()
@click.option("--recording", type=click.Path(), help="What to play. [default: construction, simulated]")
@click.option("-c", "--config", "config_path", type=click.Path(), help="Configuration, with --recording.")
@click.option("--duration", "duration_s", type=float, default=60.0, show_default=True, metavar="SECONDS")
@click.option("--nodes", type=click.Choice(["measurement", "imu"]), help="[default: as configured]")
@click.option("--imu-hz", type=FiniteRange(50.0, 2000.0), help="Rate of the IMU. [default: 100; simulated only]")
@click.option("--spin", is_flag=True, help="Spin for the last 2 ms before a sample instead of sleeping.")
@click.option("--gate", is_flag=True, help="Exit 1 if slower than the floor, at the median or at p99.")
@click.option("--json", "json_path", type=click.Path(), help="Write the result for machines.")
def realtime(  # noqa: PLR0917 (click passes the options by name)
    recording: str | None,
    config_path: str | None,
    duration_s: float,
    nodes: str | None,
    imu_hz: float | None,
    spin: bool,
    gate: bool,
    json_path: str | None,
) -> None:
    """Measure the realtime engine.

    Plays a recording at its own pace: the time from the arrival of an IMU sample until the propagated state is there,
    with the optimiser busy and, each for half as long, with an idle one, with samples back to back, and without the
    state of the chassis. The floor is GTSAM alone taking in one sample, midway between two others in the same loop,
    so that its caches are as cold.
    """
    from holdfast.bench.realtime import measure_realtime, summarise_measured, without_chassis
    from holdfast.bench.replay import describe_machine

    check_window(0.0, duration_s)
    if (recording is None) != (config_path is None):
        raise ConfigError("--recording and -c belong together")
    if recording is not None and imu_hz is not None:
        raise ConfigError("--imu-hz: a recording has its own rate (leave one of --recording and --imu-hz out)")
    if json_path is not None:
        check_output_file(json_path, [path for path in (recording, config_path) if path is not None])
    with _material(recording, config_path, duration_s, nodes, imu_hz) as (config, messages):
        pace: Pace = "spin" if spin else "sleep"
        half = messages[: len(messages) // 2]
        wanted: dict[str, tuple[Config, Sequence[Message], Pace, bool]] = {
            "busy": (config, messages, pace, False),
            "idle": (config, half, pace, True),
            "back_to_back": (config, half, "none", False),
        }
        if config.has_base():
            wanted["cabin_only"] = (without_chassis(config), half, pace, False)
        runs = {}
        for name, (used, played, how, is_idle) in wanted.items():
            with progress_bar(TITLES[name], played[0].arrival_ns, played[-1].arrival_ns) as progress:
                measured = measure_realtime(used, played, how, is_idle=is_idle, progress=progress)
            runs[name] = summarise_measured(measured)
    result = {
        "recording": recording or "construction",
        "duration_s": duration_s,
        "nodes": config.graph.nodes,
        "imu_hz": imu_hz,
        "waiting": pace,
        "machine": describe_machine(),
        "runs": runs,
    }
    _print(result)
    if json_path is not None:
        write_json(json_path, result)
    if gate:
        check(runs["busy"]["ratio_to_floor"])


def check(ratios: dict[str, float]) -> None:
    """Fail where the engine, with a busy optimiser, takes longer than the floor."""
    slower = [f"{ratio:.2f} x the floor at {name}" for name, ratio in ratios.items() if ratio > MAX_RATIO]
    if slower:
        click.echo(f"error: too slow: {', '.join(slower)} (allowed: {MAX_RATIO:g})", err=True)
        sys.exit(1)


@contextmanager
def _material(
    recording: str | None, config_path: str | None, duration_s: float, nodes: str | None, imu_hz: float | None
) -> "Iterator[tuple[Config, Sequence[Message]]]":
    """Yield the configuration and the messages, simulated where no recording is given."""
    from tempfile import TemporaryDirectory

    from holdfast.config.load import load_config
    from holdfast.lidar_odometry.replayed import ReplayedScans
    from holdfast.recording.source import open_recording
    from holdfast.recording.subscriptions import subscriptions

    with TemporaryDirectory(prefix="holdfast-bench-") as folder:
        if recording is None:
            _simulate(Path(folder), duration_s, imu_hz)
        config = load_config(config_path or f"{folder}/config.yaml")
        if nodes is not None:
            config = config.model_copy(update={"graph": config.graph.model_copy(update={"nodes": nodes})})
        with (
            open_recording(recording or folder) as opened,
            ReplayedScans(config, opened.read(subscriptions(config), 0.0, duration_s)) as scanned,
        ):
            messages = list(scanned)
    if not messages:
        raise ConfigError(f"{recording}: there is no message to play")
    yield config, messages


def _simulate(folder: Path, duration_s: float, imu_hz: float | None) -> None:
    with needing("without --recording simulating", "sim"):
        from holdfast.sim.scenario import load_scenario
        from holdfast.trial.run import write_simulation
    overrides: dict[str, Any] = {"duration_s": duration_s}
    if imu_hz is not None:
        overrides["sensors"] = {"imu": {"rate_hz": imu_hz}}
    write_simulation(load_scenario("construction", overrides), 0, folder)


def _print(result: dict[str, Any]) -> None:
    from rich import box
    from rich.table import Table

    machine, runs = result["machine"], result["runs"]
    plain = not sys.stdout.isatty()
    console = guarded_console(highlight=False, markup=False, width=120 if plain else None)
    console.print(f"{machine['cpu']}, {machine['cores']} cores, Python {machine['python']}, gtsam {machine['gtsam']}")
    console.print(f"{result['recording']}: {result['duration_s']:g} s, nodes: {result['nodes']}")
    table = Table(box=None if plain else box.SIMPLE_HEAD, pad_edge=not plain)
    table.add_column("")
    for column in COLUMNS:
        table.add_column(column, justify="right")
    quantities = [("imu_us", "IMU sample to estimate [us]", 1), ("fresh_us", "  with a new optimised state", 1)]
    quantities += [("floor_us", "  floor: GTSAM alone", 1)]
    ages = [("age_ms", "age of the optimised state [ms]", 1), ("update_ms", "update [ms]", 2)]
    for name, run in runs.items():
        table.add_row(TITLES[name], *[""] * len(COLUMNS))
        for key, title, digits in quantities + (ages if name != "back_to_back" else []):
            if run[key] is not None:
                table.add_row(title, *(f"{run[key][column]:.{digits}f}" for column in COLUMNS))
    console.print(table)
    for name, run in runs.items():
        ratios, cpu = run["ratio_to_floor"], run["cpu"]
        floors = f"{ratios['median']:.1f} x the floor at the median, {ratios['p99']:.1f} x at p99; " if ratios else ""
        console.print(f"{TITLES[name]}: {floors}CPU {cpu['imu_path']:.0%} + {cpu['optimiser']:.0%} of a core")
        late = f", {run['late']} estimates came after the next sample ({run['slow']} took so long themselves)"
        console.print(f"  samples took {cpu['imu_samples']:.1%} of a core{'' if name == 'back_to_back' else late}")
