"""From a scenario and a seed to all messages that its sensors send, and the truth about them."""

from collections.abc import Mapping
from dataclasses import dataclass

from holdfast.geometry.earth import LocalFrame
from holdfast.messages import Array
from holdfast.sim.arm import Parts
from holdfast.sim.boxes import MovingBoxes
from holdfast.sim.datasheets import SimulatedSensor
from holdfast.sim.faults import apply_faults
from holdfast.sim.motion import Motion
from holdfast.sim.readings import Readings, generator
from holdfast.sim.scenario import Scenario
from holdfast.sim.scene import Scene
from holdfast.sim.sensors import KINDS
from holdfast.sim.site import Site
from holdfast.sim.traffic import Traffic
from holdfast.sim.transport import Delivered, deliver, sample_times_s

START_NS = 1_600_000_000_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A scenario that happened.

    Attributes:
        measured: what each sensor measured, before faults and transport; with the true biases and constants.
        delivered: the messages of each sensor; those of a scanner have no columns, only times.
        world: the datum of W.
    """

    scenario: Scenario
    seed: int
    site: Site
    motion: Motion
    measured: Mapping[str, Readings]
    delivered: Mapping[str, Delivered]
    world: LocalFrame

    def imu_times_s(self) -> Array:
        """Return the true times of the cabin IMU's samples (N,), at which the truth is written."""
        return sample_times_s(self.scenario.imu.rate_hz, self.scenario.duration_s)

    def moving_boxes(self) -> list[MovingBoxes]:
        """Return what the lidar sees beside the site: the machine's own body and arm, and traffic."""
        movers = self.scenario.traffic
        seeds = [generator(self.seed, "traffic", str(number)) for number in range(len(movers))]
        return [
            Parts(self.scenario.body, self.scenario.arm, self.motion),
            Traffic(movers, self.site.terrain, self.scenario.duration_s, seeds),
        ]


def simulate(scenario: Scenario, seed: int) -> Simulation:
    """Let the machine do what the scenario says; equal scenario and seed give equal messages."""
    site = Site(scenario.ground, scenario.objects)
    motion = Motion(scenario, site.terrain, seed)
    sheets, datum = scenario.sensors, scenario.datum.point
    rotating = scenario.earth_rotation
    scene = Scene(sheets, scenario.imu_name, seed, scenario.duration_s, datum, rotating, motion, site)
    measured: dict[str, Readings] = {}
    for name, sheet in sheets.items():
        measure = KINDS[sheet.kind].measure
        if measure is not None:
            measured[name] = measure(scene.sampling(name))
    sent = apply_faults(scenario.faults, measured, sheets, scene.generator)
    delivered = {name: _deliver(scenario, scene, name, readings) for name, readings in sent.items()}
    return Simulation(scenario, seed, site, motion, measured, delivered, LocalFrame(datum))


def _deliver(scenario: Scenario, scene: Scene, name: str, readings: Readings) -> Delivered:
    faults = [fault for fault in scenario.faults if name in fault.sensors]
    return deliver(
        readings, scenario.sensors_of(SimulatedSensor)[name], faults, START_NS, scene.generator(name, "transport")
    )
