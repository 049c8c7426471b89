"""Playing messages through the engine, and comparing what comes out bit by bit."""

import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from holdfast.config.load import load_config
from holdfast.config.model import Config
from holdfast.messages import ImuSample, Message
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.sim.scenario import load_scenario
from holdfast.trial.run import write_simulation

SECONDS = 20.0


class Drive(NamedTuple):
    folder: Path
    config: Config
    messages: list[Message]

    def until(self, end_s: float) -> list[Message]:
        first_ns = self.messages[0].arrival_ns
        return [m for m in self.messages if m.arrival_ns - first_ns < end_s * 1e9]

    def between(self, begin_s: float, end_s: float) -> list[Message]:
        return self.until(end_s)[len(self.until(begin_s)) :]


def simulated(folder: Path, scenario: str = "quick", **changes) -> Drive:
    write_simulation(load_scenario(scenario, changes), 0, folder)
    config = load_config(folder / "config.yaml")
    with open_recording(folder) as recording:
        messages = list(recording.read(subscriptions(config)))
    return Drive(folder, config, messages)


def with_settings(config: Config, **sections) -> Config:
    updated = {name: getattr(config, name).model_copy(update=values) for name, values in sections.items()}
    return config.model_copy(update=updated)


def play(estimator, messages, rate: float | None = None):
    """Return the outputs at `rate` times the pace of arrival; None is as fast as it goes."""
    outputs, began, first_ns = [], time.perf_counter(), messages[0].arrival_ns
    for message in messages:
        if rate is not None:
            ahead_s = (message.arrival_ns - first_ns) * 1e-9 / rate - (time.perf_counter() - began)
            if ahead_s > 0.0:
                time.sleep(ahead_s)
        outputs.append(estimator.process(message))
    return outputs


def bring_up(estimator, messages) -> None:
    """Play the first messages at once, waiting for the optimiser as if there had been time."""
    for message in messages:
        estimator.process(message)
        if not isinstance(message, ImuSample):
            estimator.flush()
    assert estimator.initialised


def nav_bits(nav) -> bytes:
    return nav.attitude().matrix().tobytes() + nav.position().tobytes() + nav.velocity().tobytes()


def estimate_bits(estimate) -> bytes | None:
    if estimate is None:
        return None
    frame = estimate.T_W_O.matrix().tobytes() + estimate.bias.vector().tobytes() + estimate.angular_velocity.tobytes()
    covariance = np.ascontiguousarray(estimate.covariance).tobytes()
    return b"%d %d" % (estimate.stamp_ns, estimate.from_imu) + nav_bits(estimate.nav) + frame + covariance


def state_bits(state) -> bytes | None:
    if state is None:
        return None
    covariance = np.ascontiguousarray(state.covariance).tobytes()
    rest = state.bias.vector().tobytes() + state.angular_velocity.tobytes() + covariance
    return b"%d" % state.stamp_ns + nav_bits(state.nav) + rest


def base_bits(base) -> bytes | None:
    if base is None:
        return None
    twist = base.velocity.tobytes() + base.angular_velocity.tobytes()
    return base.T_O_B.matrix().tobytes() + base.T_W_B.matrix().tobytes() + twist


def bits(output):
    smoothed = [(stamp_ns, nav_bits(nav)) for stamp_ns, nav in output.smoothed]
    return estimate_bits(output.estimate), state_bits(output.optimised), base_bits(output.base), smoothed


def events_of(estimator):
    return sorted((e.stamp_ns, str(e.kind), e.sensor, e.reason) for e in estimator.take_events())


def shifted(messages, by_ns: int):
    """The same messages with clocks that show another time."""
    return [replace(m, stamp_ns=m.stamp_ns + by_ns, arrival_ns=m.arrival_ns + by_ns) for m in messages]


def wait_for(condition, timeout_s: float = 30.0) -> None:
    until = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until, "it never came true"
        time.sleep(0.02)


def stamps_of(outputs):
    return [o.estimate.stamp_ns for o in outputs if o.estimate is not None]


def sigmas_m(outputs):
    """Standard deviation of the position of each estimate."""
    found = [o.estimate for o in outputs if o.estimate is not None]
    return np.array([np.sqrt(np.trace(e.covariance[3:6, 3:6])) for e in found])
