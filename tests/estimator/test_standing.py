"""Standstill: found through engine vibration, not taken for a machine that creeps away."""

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest
from motion import UP, deviation, estimates, fixes, imu, in_order, machine, ns, run, seconds

from holdfast.estimator.estimator import Estimator
from holdfast.events import Outcome


@dataclass(frozen=True)
class Line:
    """Stands until `start_s`, then accelerates along x."""

    start_s: float
    acceleration: float

    def nav(self, t):
        t = max(0.0, t - self.start_s)
        a = self.acceleration
        return gtsam.NavState(gtsam.Rot3(), np.array([0.5 * a * t * t, 0.0, 0.0]), np.array([a * t, 0.0, 0.0]))

    def pose(self, t):
        return self.nav(t).pose()

    def readings(self, t):
        return UP + np.array([self.acceleration if t >= self.start_s else 0.0, 0.0, 0.0]), np.zeros(3)


def driven(motion, end_s, vibration=0.0, hz=100.0, **sections):
    rng = np.random.default_rng(1)
    samples = imu(motion, 0.0, end_s, hz, rng)
    for k, sample in enumerate(samples):
        sample.specific_force[:] += vibration * np.sqrt(2.0) * np.sin(2.0 * np.pi * 27.0 * k / hz)
    messages = in_order(samples, fixes(motion, 0.0, end_s, 10.0, rng, phase_s=0.0137))
    return messages, machine(lidar=False, heading_deg=0.0, **sections)


@pytest.mark.parametrize("vibration", [0.0, 0.1])
def test_no_node_that_moves_is_held_to_zero_velocity(vibration, monkeypatch):
    """0.3 m/s^2: after a tenth of a second the machine is faster than the factor's three sigma."""
    from holdfast.graph.smoother import Smoother

    held, original = [], Smoother.enter_zero_velocity

    def noting(self, standing, sigma_m_s):
        held.append(standing.stamp_ns)
        original(self, standing, sigma_m_s)

    monkeypatch.setattr(Smoother, "enter_zero_velocity", noting)
    motion = Line(5.0, 0.3)
    messages, config = driven(motion, 8.0, vibration)
    _estimator, outputs = run(config, messages)
    assert len(held) > 5
    fastest = max(np.linalg.norm(motion.nav(seconds(stamp)).velocity()) for stamp in held)
    assert fastest < 3.0 * config.standstill.velocity_sigma_m_s
    assert deviation(motion, estimates(outputs)[-1])[0] < 0.05


@pytest.mark.parametrize(("vibration", "found"), [(0.1, True), (0.5, False)])
def test_vibration_below_the_bound_is_standstill_and_above_it_is_not(vibration, found):
    # initialise first, quietly: the engine starts later
    motion = Line(100.0, 0.0)
    messages, config = driven(motion, 2.0)
    rough, _ = driven(motion, 6.0, vibration)
    estimator = Estimator(config)
    for message in messages:
        estimator.process(message)
    before = estimator.counts["standstill", Outcome.USED]
    for message in rough:
        if message.arrival_ns > ns(3.2) or (message.sensor == "imu" and message.arrival_ns > ns(2.0)):
            estimator.process(message)
    assert (estimator.counts["standstill", Outcome.USED] - before > 5) == found


def test_standstill_holds_a_machine_without_any_other_sensor():
    """Two minutes of drift at a bias of 2 cm/s^2 would be 144 m."""
    motion = Line(1000.0, 0.0)
    rng = np.random.default_rng(1)
    samples = imu(motion, 0.0, 30.0, 50.0, rng, bias=[0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
    messages = in_order(samples, fixes(motion, 0.0, 2.0, 10.0, rng))
    _, outputs = run(machine(lidar=False, heading_deg=0.0), messages)
    assert deviation(motion, estimates(outputs)[-1])[0] < 0.05
    _, free = run(machine(lidar=False, heading_deg=0.0, standstill={"enabled": False}), messages)
    assert deviation(motion, estimates(free)[-1])[0] > 0.2
