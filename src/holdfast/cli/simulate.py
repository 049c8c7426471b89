"""`holdfast simulate`: a recording whose truth is known."""

from pathlib import Path

import click

from holdfast.cli.progress import progress_bar
from holdfast.errors import ConfigError, HoldfastError
from holdfast.extras import needing
from holdfast.output_folder import SIMULATE, naming_the_output, replaced


@click.command()
@click.argument("scenario")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder for the results.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of every random number.")
@click.option("--scans", is_flag=True, help="Ray-cast the lidar's scans too (about 0.5 MB each).")
@click.option("--duration", "duration_s", type=float, metavar="SECONDS", help="Shorter or longer than the scenario.")
def simulate(scenario: str, output: Path, seed: int, scans: bool, duration_s: float | None) -> None:
    """Simulate SCENARIO, a shipped one or a YAML file, and write what the machine would have recorded.

    Shipped: construction, navigation, tunnel, liar, late, clocks, moving-start, rough, quick, wheels, two-lidars,
    prism, new-sensors, slow-errors; with scans gallery, open-field, arm-and-traffic, without-arm-and-traffic; rounds,
    and with a configuration that is wrong wrong-mount, offset-clocks, wrong-encoder, noisy-odometry, good-odometry,
    boastful-fixes, one-antenna, scaled-gyroscope; degraded-fixes, frozen-odometry.

    Writes to the output folder: recording.mcap (ROS 2), config.yaml for `holdfast replay`, truth/ (poses, velocities,
    biases, constants, errors of the fixes), site.ply, plan.png, scenario.yaml with every setting, and a README.md.
    Equal scenario and seed give equal bytes.
    """
    with needing("simulating", "sim"):
        from holdfast.sim.recorder import write_recording, write_truth
        from holdfast.sim.simulation import START_NS
        from holdfast.sim.simulation import simulate as run
    from holdfast.config.load import resolved_yaml
    from holdfast.sim.account import account
    from holdfast.sim.configuration import configuration
    from holdfast.sim.scenario import LONGEST_S, SHORTEST_S, load_scenario

    if duration_s is not None and not SHORTEST_S < duration_s <= LONGEST_S:
        raise ConfigError(f"--duration {duration_s:g}: must be > {SHORTEST_S:g} and <= {LONGEST_S:g}")
    loaded = load_scenario(scenario, {} if duration_s is None else {"duration_s": duration_s})
    name = Path(scenario).stem
    asked = ("" if duration_s is None else f" --duration {duration_s:g}") + " --scans" * scans
    with naming_the_output(output), replaced(output, SIMULATE, [scenario]):
        simulation = run(loaded, seed)
        (output / "scenario.yaml").write_text(resolved_yaml(loaded), encoding="utf-8")
        config = resolved_yaml(configuration(loaded, seed), given_only=True)
        (output / "config.yaml").write_text(f"# For recordings of the scenario {name}.\n{config}", encoding="utf-8")
        write_truth(simulation, output / "truth")
        simulation.site.write_ply(output / "site.ply")
        end_ns = START_NS + round(loaded.duration_s * 1e9)
        with progress_bar("simulating", START_NS, end_ns) as progress:
            counts = write_recording(simulation, output / "recording.mcap", scans, progress)
        command = f"holdfast simulate {scenario} -o {output.name} --seed {seed}{asked}"
        (output / "README.md").write_text(account(simulation, name, command, counts), encoding="utf-8")
        try:
            from holdfast.sim.plan_view import draw_plan

            draw_plan(simulation, output / "plan.png")
        except HoldfastError as error:
            click.echo(f"no figure: {error}", err=True)
    click.echo(
        f"{name}: {loaded.duration_s:g} s, {simulation.motion.distance_m:.0f} m driven, "
        f"{sum(counts.values())} messages, seed {seed}"
    )
    click.echo(f"written to {output}: recording.mcap, config.yaml, truth, site.ply, plan.png, scenario.yaml, README.md")
