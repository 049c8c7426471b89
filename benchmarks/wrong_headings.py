"""Prints what a heading costs that is not as the file says: `python benchmarks/wrong_headings.py`.

A scenario with two antennas and the heading of their receiver is simulated, and estimated with `mounting_yaw_deg` as it
is, then wrong; then with its `time_offset_s` wrong; all this again without the second antenna, so that nothing but the
motion tells how the heading is mounted. The truth of the simulation judges while fixes come, from the start on.
`--known`: the file says that the mounting is known.
"""

import argparse
from copy import deepcopy
from typing import Any

from wrong_by_ten import print_scored

from holdfast.config.load import config_of
from holdfast.config.sensors import HeadingConfig
from holdfast.sensors.heading import configured_yaw_deg
from holdfast.sim.configuration import configuration_data
from holdfast.sim.scenario import load_scenario

ANGLES_DEG = (0.5, 1.0, 2.0, 5.0, 10.0, 45.0, 180.0)
LATE_S = (0.01, 0.02, 0.05, 0.1, 0.25)
SHOWN = ("with GNSS", "heading", "outage", "heading there")


def wrong(data: dict[str, Any], by_deg: float, by_s: float, *, is_alone: bool, is_known: bool) -> dict[str, Any]:
    """Return a configuration whose headings are mounted or dated otherwise; with one antenna, or all that there are."""
    changed = deepcopy(data)
    sensors, config = changed["sensors"], config_of(data, "as it is")
    for name in config.sensors_of(HeadingConfig):
        sensors[name]["mounting_yaw_deg"] = configured_yaw_deg(name, config) + by_deg
        sensors[name]["time_offset_s"] = sensors[name].get("time_offset_s", 0.0) - by_s
        if is_known:
            sensors[name]["mounting_sigma_deg"] = 0.0
    antennas = [name for name, section in sensors.items() if section["kind"] == "gnss"]
    for name in antennas[1:] if is_alone else ():
        del sensors[name]
    return changed


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="rounds")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--deg", type=float, nargs="*", default=ANGLES_DEG, help="by which the file is wrong")
    parser.add_argument("--seconds", type=float, nargs="*", default=LATE_S, help="by which they are late")
    parser.add_argument("--known", action="store_true", help="the file says that the mounting is known")
    given = parser.parse_args()
    scenario = load_scenario(given.scenario)
    data = configuration_data(scenario, given.seed)
    offs = [(0.0, 0.0), *((by_deg, 0.0) for by_deg in given.deg), *((0.0, by_s) for by_s in given.seconds)]
    tried = [
        ((antennas, f"{by_deg:g}", f"{by_s:g}"), wrong(data, by_deg, by_s, is_alone=is_alone, is_known=given.known))
        for antennas, is_alone in (("two", False), ("one", True))
        for by_deg, by_s in offs
    ]
    print_scored(scenario, given.seed, ("antennas", "turned by [deg]", "late by [s]"), tried, SHOWN)


if __name__ == "__main__":
    main()
