"""Prints what a clock costs that is not as the file says: `python benchmarks/wrong_clocks.py SCENARIO`.

A scenario is simulated, and estimated with `time_offset_s` of one sensor after another wrong, all else as it is. The
truth of the simulation judges while fixes come, from the start on, and in outages.
"""

import argparse
from copy import deepcopy
from typing import Any

from wrong_by_ten import print_scored

from holdfast.sim.configuration import configuration_data
from holdfast.sim.scenario import load_scenario

LATE_S = (0.02, 0.1, 0.25)
SHOWN = ("with GNSS", "heading", "outage", "heading there", "chassis")


def late(data: dict[str, Any], sensor: str, by_s: float) -> dict[str, Any]:
    """Return a configuration by which the stamps of a sensor are late."""
    changed = deepcopy(data)
    section = changed["sensors"][sensor]
    section["time_offset_s"] = section.get("time_offset_s", 0.0) - by_s
    return changed


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="new-sensors")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, nargs="+", default=LATE_S, help="by which a sensor is late")
    parser.add_argument("--only", default="", help="sensors with this in their name")
    given = parser.parse_args()
    scenario = load_scenario(given.scenario)
    data = configuration_data(scenario, given.seed)
    sensors = [name for name, one in data["sensors"].items() if "topic" in one and one["kind"] != "imu"]
    wrong = [(name, by_s) for name in sensors if given.only in name for by_s in given.seconds]
    tried = [(("none", "0"), data), *(((name, f"{by_s:g}"), late(data, name, by_s)) for name, by_s in wrong)]
    print_scored(scenario, given.seed, ("sensor", "late by [s]"), tried, SHOWN)


if __name__ == "__main__":
    main()
