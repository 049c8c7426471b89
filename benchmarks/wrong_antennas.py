"""Prints what antennas cost a machine that are not where the file says: `python benchmarks/wrong_antennas.py`.

A scenario with two antennas is simulated and estimated with their lever arms as they are, then moved along x and y of
the machine: both, as where the origin of the file is elsewhere, one of them, and one where the other is left out; then
the two are exchanged. The truth of the simulation judges while fixes come, from the start on.
"""

import argparse
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from wrong_by_ten import print_scored

from holdfast.sim.configuration import configuration_data
from holdfast.sim.scenario import load_scenario

DISTANCES_M = (0.3, 1.0, 3.0)
WHICH = ("both", "one", "alone", "exchanged")
SHOWN = ("with GNSS", "heading", "outage")


def moved(data: dict[str, Any], which: str, by: Sequence[float], *, is_known: bool) -> dict[str, Any]:
    """Return a configuration with antennas that are elsewhere by a vector (3,) [m]; it may say that they are not."""
    changed = deepcopy(data)
    sensors = changed["sensors"]
    antennas = [name for name, section in sensors.items() if section["kind"] == "gnss"]
    frames = [sensors[name].get("frame", name) for name in antennas]
    for name in antennas if is_known else ():
        sensors[name]["lever_arm_sigma_m"] = 0.0
    if which == "alone":
        headings = [name for name, section in sensors.items() if section["kind"] == "heading"]
        for name in (*antennas[1:], *headings):
            del sensors[name]
    links = {link["child"]: link for link in changed["extrinsics"]}
    if which == "exchanged":
        one, other = (links[frame] for frame in frames[:2])
        one["translation_m"], other["translation_m"] = other["translation_m"], one["translation_m"]
    for link in links.values():
        if link["child"] in (frames if which == "both" else frames[:1]):
            link["translation_m"] = (np.array(link["translation_m"]) + by).tolist()
    return changed


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="rounds")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--m", type=float, nargs="+", default=DISTANCES_M, help="moved by")
    parser.add_argument("--known", action="store_true", help="the file says that the places of antennas are known")
    parser.add_argument("--which", nargs="+", choices=WHICH, default=WHICH)
    given = parser.parse_args()
    scenario = load_scenario(given.scenario)
    data = configuration_data(scenario, given.seed)
    distances = {which: (0.0,) if which == "exchanged" else (0.0, *given.m) for which in given.which}
    tried = [
        ((which, axis if by_m else "", f"{by_m:g}"), moved(data, which, by_m * along, is_known=given.known))
        for which in given.which
        for by_m in distances[which]
        for axis, along in zip("xy"[: 2 if by_m else 1], np.eye(3), strict=False)
    ]
    print_scored(scenario, given.seed, ("antennas", "axis", "moved by [m]"), tried, SHOWN)


if __name__ == "__main__":
    main()
