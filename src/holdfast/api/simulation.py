"""`holdfast.simulate`: a machine on a site, whose truth is known."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from holdfast.api.trajectory import Trajectory
from holdfast.arguments import check_count, path_of
from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.measured_fields import got, is_number
from holdfast.output_folder import SIMULATE, naming_the_output, replaced


@dataclass(frozen=True, slots=True)
class Simulated:
    """A simulated recording.

    Attributes:
        recording: for `holdfast.replay` or `holdfast.smooth`.
        config: that belongs to it.
        truth: I in W, as it was.
    """

    recording: Path
    config: Path
    truth: Trajectory


def simulate(
    scenario: str | PathLike[str],
    output: str | PathLike[str],
    *,
    seed: int = 0,
    duration_s: float | None = None,
) -> Simulated:
    """Simulate a scenario, a shipped one or a YAML file, into a folder; equal seeds give equal bytes.

    The folder is replaced as a whole, and one that holds anything but an earlier simulation is refused.

    Raises:
        ConfigError: there is no such scenario, it holds mistakes, the simulator's packages are not installed, or the
            folder is refused or cannot be written.
    """
    with needing("simulating", "sim"):
        from holdfast.sim.recorder import write_truth
        from holdfast.sim.scenario import LONGEST_S, SHORTEST_S, load_scenario
        from holdfast.trial.run import CONFIG, RECORDING, write_simulation
    path_of("scenario", scenario)
    folder = path_of("output", output)
    check_count("seed", seed, 0)
    if duration_s is not None and not (is_number(duration_s) and SHORTEST_S < duration_s <= LONGEST_S):
        raise ConfigError(f"duration_s: must be > {SHORTEST_S:g} and <= {LONGEST_S:g} [s], {got(duration_s)}")
    loaded = load_scenario(str(scenario), {} if duration_s is None else {"duration_s": duration_s})
    with naming_the_output(folder), replaced(folder, SIMULATE, [str(scenario)]):
        write_truth(write_simulation(loaded, seed, folder), folder / "truth")
    truth = Trajectory.read(folder / "truth" / "imu_in_world.tum")
    return Simulated(folder / RECORDING, folder / CONFIG, truth)
