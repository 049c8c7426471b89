"""The scenario as documentation: `python -m holdfast.sim.reference docs/simulation.md` writes its tables anew."""

import sys

from holdfast.config.reference import rewrite
from holdfast.sim.scenario import Scenario

COMMAND = "python -m holdfast.sim.reference docs/simulation.md"

if __name__ == "__main__":
    rewrite(sys.argv[1], Scenario, COMMAND)
