"""The README of a simulated recording: what was done, where the truth is, what goes wrong when."""

from collections.abc import Iterator, Mapping

from holdfast.sim.fault import Fault
from holdfast.sim.scenario import Activity
from holdfast.sim.simulation import Simulation


def account(simulation: Simulation, name: str, command: str, counts: Mapping[str, int]) -> str:
    """Return the text (Markdown); `counts` are the numbers of messages by topic."""
    return "\n".join(_lines(simulation, name, command, counts)) + "\n"


def _lines(simulation: Simulation, name: str, command: str, counts: Mapping[str, int]) -> Iterator[str]:
    scenario, motion = simulation.scenario, simulation.motion
    yield from (f"# {name}, seed {simulation.seed}", "", scenario.description, "")
    yield (
        f"{scenario.duration_s:g} s of `{scenario.machine}` on `{scenario.site}`; the chassis drives "
        f"{motion.distance_m:.0f} m. Everything here is simulated. Made by:"
    )
    yield from ("", "```sh", command, "```", "", "Estimate and judge:", "", "```sh")
    yield "holdfast replay recording.mcap -c config.yaml -o estimate"
    yield "holdfast evaluate estimate/imu_in_world.tum truth/imu_in_world.tum"
    yield from ("```", "", "## Messages", "", "| Topic | Messages |", "|---|---|")
    yield from (f"| `{topic}` | {count} |" for topic, count in counts.items())
    yield from ("", "## What the machine does", "")
    yield from _activities(scenario.activities, "")
    yield from ("", "## What goes wrong", "")
    yield from (f"- {_fault(fault)}" for fault in scenario.faults)
    if not scenario.faults:
        yield "Nothing, but for the noise of the sensors and what trees hide of the sky."
    yield from _truth(simulation)


def _truth(simulation: Simulation) -> Iterator[str]:
    yield from ("", "## Truth", "")
    yield (
        "`truth/` is what no machine has, at the rate of the cabin's IMU and in true time: `imu_in_world.tum`, "
        "`base_in_world.tum` and those of the odometries (poses in W), `velocities.csv`, the biases of the IMUs, "
        "`joint.csv` and, under the stamps of their messages, the errors of all positions. `constants.csv` has:"
    )
    yield ""
    for name, readings in simulation.measured.items():
        yield from (f"- {constant} of {name}: {value:.6f}" for constant, value in readings.constants.items())
    yield ""
    yield "`site.ply` is the surface that the lidar sees; `scenario.yaml` holds every setting, defaults included."


def _activities(activities: tuple[Activity, ...], indent: str) -> Iterator[str]:
    for activity in activities:
        if activity.stand_s is not None:
            yield f"{indent}- stand for {activity.stand_s:g} s"
        elif activity.drive_to_m is not None:
            yield f"{indent}- drive to " + ", ".join(f"({x:g}, {y:g})" for x, y in activity.drive_to_m)
        elif activity.slew_to_deg is not None:
            yield f"{indent}- slew the cabin to {activity.slew_to_deg:g} deg"
        elif activity.dig is not None:
            yield f"{indent}- dig {activity.dig.cycles} buckets, dumping {activity.dig.swing_deg:g} deg to the side"
        else:
            yield f"{indent}- up to {activity.repeat} times, as long as the recording lasts:"
            yield from _activities(activity.of, indent + "  ")


def _fault(fault: Fault) -> str:
    details = {
        "outage": "no messages"
        if fault.claim_growth_m_s is None
        else f"claimed sigma grows by {fault.claim_growth_m_s:g} m/s",
        "degraded": f"falls to {fault.quality}",
        "walk": f"walks away at {fault.rate_m_s:g} m/s, to {_vector(fault)} m",
        "offset": f"off by {_vector(fault)} m, with the claim of good ones",
        "spikes": f"every {fault.period_s:g} s one is off by {_vector(fault)} m",
        "swap": f"antennas exchanged, or another prism followed, {_vector(fault)} m away",
        "silence": "no messages",
        "line": "the logger draws lines",
        "jump": f"jumps by {_vector(fault)} m and {fault.yaw_deg:g} deg",
        "freeze": "repeats itself",
        "slip": f"velocity off by {fault.slip_ratio:g} of itself and {fault.slip_m_s:g} m/s",
        "clock_step": f"clock is off by {fault.step_s:g} s",
        "flood": f"every message is repeated at {fault.flood_hz:g} Hz",
        "twin": f"a second publisher, off by {fault.step_s:g} s and {fault.behind} messages behind",
        "garbage": f"{fault.garbage_ratio:g} of the messages mean nothing",
    }
    when = f"{fault.start_s:g} to {fault.end_s:g} s"
    return f"{when}: {fault.kind} of {', '.join(fault.sensors)} ({details[fault.kind]})"


def _vector(fault: Fault) -> str:
    return "(" + ", ".join(f"{value:g}" for value in fault.offset_m) + ")"
