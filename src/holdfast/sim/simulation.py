"""From a scenario and a seed to all messages that its sensors send, and the truth about them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from holdfast.geometry.earth import LocalFrame, earth_rate_enu, gravity
from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedGnss, SimulatedSensor
from holdfast.sim.faults import apply_faults
from holdfast.sim.gnss import Antenna, fix_quality, gnss_readings
from holdfast.sim.heading import heading_readings
from holdfast.sim.imu import Bias, imu_readings
from holdfast.sim.joint import joint_readings
from holdfast.sim.motion import Motion
from holdfast.sim.odometry import odometry_readings
from holdfast.sim.readings import Readings, generator
from holdfast.sim.scenario import Scenario
from holdfast.sim.site import Site
from holdfast.sim.transport import Delivered, deliver, sample_times_s

START_NS = 1_600_000_000_000_000_000
SKY_STEP_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A scenario that happened.

    Attributes:
        delivered: the messages of each sensor; those of the scanner have no columns, only times.
        biases: true biases of the IMUs by sensor.
        joint_bias_rad: true zero offset of the encoder.
        world: the datum of W.
    """

    scenario: Scenario
    seed: int
    site: Site
    motion: Motion
    delivered: Mapping[str, Delivered]
    biases: Mapping[str, Bias]
    joint_bias_rad: float
    world: LocalFrame

    def imu_times_s(self) -> Array:
        """Return the true times of the cabin IMU's samples (N,), at which the truth is written."""
        return sample_times_s(self.scenario.sensors.imu.rate_hz, self.scenario.duration_s)


def simulate(scenario: Scenario, seed: int) -> Simulation:
    """Let the machine do what the scenario says; equal scenario and seed give equal messages."""
    site = Site(scenario.ground, scenario.objects)
    motion = Motion(scenario, site.terrain, seed)
    generators = partial(generator, seed)
    sheets = scenario.sensors
    readings: dict[str, Readings] = {}
    biases: dict[str, Bias] = {}
    datum = scenario.geodetic_datum
    earth_rate = earth_rate_enu(datum.latitude_deg) if scenario.earth_rotation else None
    for name, sheet in (("imu", sheets.imu), ("base_imu", sheets.base_imu)):
        if sheet is not None:
            times_s = _times_s(scenario, name, sheet, seed)
            g = gravity(datum.latitude_deg, datum.altitude_m)
            moving = motion.frame(sheet.frame, times_s)
            readings[name], biases[name] = imu_readings(sheet, moving, times_s, g, earth_rate, generators(name))
    readings |= _receiver(scenario, site, motion, seed)
    joint_bias_rad = 0.0
    if sheets.joint is not None:
        times_s = _times_s(scenario, "joint", sheets.joint, seed)
        angles_rad, _ = motion.joint(times_s)
        readings["joint"], joint_bias_rad = joint_readings(sheets.joint, angles_rad, times_s, generators("joint"))
    if sheets.lidar is not None:
        times_s = _times_s(scenario, "lidar", sheets.lidar, seed)
        moving = motion.frame(sheets.lidar.frame, times_s)
        readings["lidar"] = odometry_readings(sheets.lidar, moving, times_s, generators("lidar"))
    if sheets.scanner is not None:
        readings["scanner"] = Readings(_times_s(scenario, "scanner", sheets.scanner, seed), {})
    readings = apply_faults(scenario.faults, readings, _gnss_sheets(scenario), generators)
    delivered = {name: _deliver(scenario, name, rows, seed) for name, rows in readings.items()}
    world = LocalFrame(datum)
    return Simulation(scenario, seed, site, motion, delivered, biases, joint_bias_rad, world)


def _times_s(scenario: Scenario, name: str, sheet: SimulatedSensor, seed: int) -> Array:
    """Return when a sensor measures: the cabin IMU begins at zero, every other one at a time of its own."""
    phase = 0.0 if name == "imu" else float(generator(seed, name, "phase").uniform(0.0, 1.0 / sheet.rate_hz))
    return sample_times_s(sheet.rate_hz, scenario.duration_s, phase)


def _epochs_s(scenario: Scenario, sheet: SimulatedSensor, seed: int) -> Array:
    """Return when the receiver measures something: antennas and heading share the epochs of the fastest antenna."""
    fastest_hz = max(antenna.rate_hz for antenna in _gnss_sheets(scenario).values())
    phase = float(generator(seed, "receiver", "phase").uniform(0.0, 1.0 / fastest_hz))
    return sample_times_s(sheet.rate_hz, scenario.duration_s, phase)


def _gnss_sheets(scenario: Scenario) -> dict[str, SimulatedGnss]:
    both = {"gnss": scenario.sensors.gnss, "gnss_right": scenario.sensors.gnss_right}
    return {name: sheet for name, sheet in both.items() if sheet is not None}


def _receiver(scenario: Scenario, site: Site, motion: Motion, seed: int) -> dict[str, Readings]:
    """Return fixes and headings, under the sky that each antenna sees."""
    seconds = np.arange(0.0, scenario.duration_s + SKY_STEP_S, SKY_STEP_S)
    sheets = _gnss_sheets(scenario)
    open_sky = {name: site.sky_view(motion.frame(sheet.frame, seconds).p_W) for name, sheet in sheets.items()}
    antennas = {}
    for name, sheet in sheets.items():
        times_s = _epochs_s(scenario, sheet, seed)
        quality = fix_quality(sheet, times_s, np.interp(times_s, seconds, open_sky[name]))
        antennas[name] = Antenna(sheet, times_s, motion.frame(sheet.frame, times_s).p_W, quality)
    readings = gnss_readings(antennas, partial(generator, seed))
    heading = scenario.sensors.heading
    if heading is not None and len(sheets) == 2:
        times_s = _epochs_s(scenario, heading, seed)
        left, right = (motion.frame(sheet.frame, times_s) for sheet in sheets.values())
        qualities = [fix_quality(s, times_s, np.interp(times_s, seconds, open_sky[n])) for n, s in sheets.items()]
        readings["heading"] = heading_readings(
            heading,
            left,
            right,
            times_s,
            left_quality=qualities[0],
            right_quality=qualities[1],
            rng=generator(seed, "heading"),
        )
    return readings


def _deliver(scenario: Scenario, name: str, rows: Readings, seed: int) -> Delivered:
    sheet = scenario.sensors.present()[name]
    steps = [fault for fault in scenario.faults if fault.kind == "clock_step" and name in fault.sensors]
    # a sweep is complete, and sent, one turn after its first column
    ready_s = 1.0 / sheet.rate_hz if name == "scanner" else 0.0
    return deliver(rows, sheet, steps, START_NS, generator(seed, name, "transport"), ready_s=ready_s)
