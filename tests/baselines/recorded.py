"""Messages of small simulations, and the outputs of the systems."""

from dataclasses import replace
from functools import cache

import numpy as np

from holdfast.config.load import parse_config, resolved_yaml
from holdfast.messages import GnssFix, SensorPose
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.sim.configuration import configuration
from holdfast.sim.recorder import write_recording
from holdfast.sim.scenario import load_scenario
from holdfast.sim.simulation import START_NS, simulate

SENSORS = ("imu", "gnss", "gnss_right", "heading", "lidar")
PERFECT_LIDAR = {
    **dict.fromkeys(("jitter_m", "jitter_rad"), 0.0),
    **dict.fromkeys(("drift_m_per_sqrt_m", "drift_rad_per_sqrt_m", "drift_rad_per_sqrt_rad"), 0.0),
}


class Recorded:
    """One simulation, its configuration and its messages in the order of arrival."""

    def __init__(self, folder, name="quick", seed=1, **overrides):
        scenario = load_scenario(name, overrides)
        self.simulation = simulate(scenario, seed)
        self.config = parse_config(resolved_yaml(configuration(scenario), given_only=True))
        write_recording(self.simulation, folder / "recording.mcap", False, None)
        with open_recording(folder / "recording.mcap") as recording:
            self.messages = [one for one in recording.read(subscriptions(self.config)) if one.sensor in SENSORS]
        self.frame = scenario.imu.frame

    @cache  # noqa: B019 (lives as long as the tests)
    def truth_at(self, stamp_ns):
        """Return p_W_I, R_W_I and v_W at a time."""
        moving = self.simulation.motion.frame(self.frame, np.array([(stamp_ns - START_NS) * 1e-9]))
        return moving.p_W[0], moving.R_W_F[0], moving.v_W[0]

    def errors(self, estimates):
        """Return estimate minus truth of the positions (N, 3) [m]."""
        return np.array([e.nav.position() - self.truth_at(e.stamp_ns)[0] for e in estimates])


def outputs_of(localiser, messages):
    """Return estimates and optimised states that a system gives."""
    outputs = [localiser.process(message) for message in messages]
    return [o.estimate for o in outputs if o.estimate is not None], [o.optimised for o in outputs if o.optimised]


def later(messages, kinds, delay_ns):
    """Return messages of some kinds arriving later, in the order of arrival."""
    moved = [replace(m, arrival_ns=m.arrival_ns + delay_ns) if isinstance(m, kinds) else m for m in messages]
    return sorted(moved, key=lambda message: message.arrival_ns)


__all__ = ["PERFECT_LIDAR", "GnssFix", "Recorded", "SensorPose", "later", "outputs_of"]
