# ruff: noqa: PLR0917 - what is tested is made of many small choices with defaults
"""The graphs of a machine whose motion is known, begun at the truth: what judges measurements is tested on them."""

import gtsam
import numpy as np
from motion import ARM, DATUM, G, imu, machine, ns

from holdfast.event_log import EventLog
from holdfast.geometry.world import World
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.smoother import Smoother
from holdfast.integrity.headings import Headings
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT
from holdfast.integrity.lever_arms import LeverArms
from holdfast.integrity.noise_scale import NoiseScale
from holdfast.integrity.odometries import Odometries
from holdfast.integrity.positions import Positions
from holdfast.integrity.recovery import Recovery
from holdfast.integrity.states import States
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import Position, Role
from holdfast.state import OptimisedState

SIGMAS = np.repeat([0.005, 0.01, 0.02, 1e-3, 1e-5], 3)
NO_BIAS = gtsam.imuBias.ConstantBias()


def truth(motion, t, sigmas=SIGMAS):
    """The true state at a time, with standard deviations `sigmas` (15,)."""
    return OptimisedState(ns(t), motion.nav(t), NO_BIAS, np.diag(sigmas**2), motion.readings(t)[1])


def buffered(motion, end_s, config=None, hz=100.0, start_s=0.0, samples=None):
    """The samples of the IMU until a time."""
    buffer = ImuBuffer((config or machine()).imu)
    for sample in samples or imu(motion, start_s, end_s, hz):
        buffer.add(sample)
    return buffer


def smoother_of(motion, end_s, start_s=0.0, config=None, state=None, **more):
    """A smoother at the start, over the samples until the end."""
    config = config or machine()
    return Smoother(
        config, buffered(motion, end_s, config, start_s=start_s), G, state or truth(motion, start_s), **more
    )


class Rig:
    """What `Tracking` is made of, by name; `update` optimises as it does, but reviews nothing."""

    def __init__(self, motion, config, end_s=30.0, start_s=0.0, samples=None, carried=NOTHING_LEARNT):
        def of(*roles):
            return {name: sensor for name, sensor in self.sensors.items() if sensor.role in roles}

        self.motion, self.sensors, self.log = motion, sensors_of(config), EventLog(config.imu_name)
        self.scales = scales = {name: NoiseScale() for name in self.sensors}
        after_s = config.gate.patience_s(has_odometry=bool(of(Role.ODOMETRY)))
        self.lever_arms = LeverArms(self.sensors)
        self.positions = Positions(
            config.gate,
            of(Role.POSITION),
            scales,
            self.lever_arms,
            self.log,
            since_ns=round(start_s * 1e9),
            believe_after_s=after_s,
        )
        self.headings = Headings(of(Role.HEADING), scales, self.log, lambda *_: None)
        self.odometries = Odometries(
            config,
            of(Role.ODOMETRY),
            self.log,
            headings=self.witness,
            fixes=lambda *_: False,
            date_later=lambda *_: None,
            carried=carried.odometries,
        )
        self.states = States(of(Role.STATE, Role.VELOCITY, Role.POSE), scales, lambda _: None, self.log)
        self.recovery = Recovery(config.gate, self.positions, self.headings, self.odometries, self.log)
        self.buffer = buffered(motion, end_s, config, start_s=start_s, samples=samples)
        self.graph = DualGraph(config, self.buffer, G, self.odometries.new_tracks(), truth(motion, start_s))
        self.world = World()
        self.world.place(DATUM)

    def witness(self, smoother, stamp_ns):
        return self.headings.witness(smoother, stamp_ns) or self.positions.heading_witness(smoother, stamp_ns)

    def convert(self, message):
        return self.sensors[message.sensor].convert(message, self.world)

    def update(self):
        for smoother in self.graph.smoothers():
            smoother.optimise()

    def events(self):
        """Kinds and sensors of what was reported since the last call."""
        return [(event.kind, event.sensor) for event in self.log.take_events()]

    def error_m(self):
        """By how much the published state is off."""
        newest = self.graph.published.newest
        expected = self.motion.nav((newest.stamp_ns - ns(0.0)) * 1e-9).position()
        return float(np.linalg.norm(newest.nav.position() - expected))


def position(motion, t, arm, offset=(0.0, 0.0, 0.0), sensor="gnss", sigma_m=0.01):
    """A checked position of a point of the machine."""
    at = motion.pose(t).transformFrom(np.asarray(arm)) + np.asarray(offset)
    return Position(ns(t), sensor, at, np.eye(3) * sigma_m**2, 0.0)


def enter(smoother, measured):
    """Let a position of the antenna enter a smoother; return it."""
    noise = gtsam.noiseModel.Gaussian.Covariance(measured.covariance)
    key = smoother.node(measured.stamp_ns)
    smoother.enter(measured, gtsam.GPSFactor2Arm(key, measured.p_W_P, ARM, noise))
    return measured
