"""Sensors with a clock of their own that send where the machine was seconds ago: a total station's prism, markers.

Beside an odometry the estimate leaves such positions while the machine moves, and finds them again where it stands.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import Outcome
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.smoother import Smoother
from holdfast.integrity.far_delay import DateLater, Delays, FarDelay, Seen
from holdfast.integrity.positions import Positions
from holdfast.integrity.residual import residual
from holdfast.integrity.states import States
from holdfast.messages import Array
from holdfast.sensors.clock import has_estimated_clock
from holdfast.sensors.pose import FramePose
from holdfast.sensors.sensor import Position, PositionSensor, StateSensor, is_gnss

BESIDE_M = 0.05  # by which positions that are late are beside the estimate at least, in the mean
LEFT_M = 0.3  # by which the estimate may have been drawn astray by them

SeenInWorld = Callable[[Any, Any, Smoother], Seen]
"""Takes the model of a sensor, what it measured and a smoother; says where that is in W [m], and was expected."""


class LateSensors:
    """Lets a channel judge what sensors say of where the machine is, and dates anew what is late or early by far.

    Args:
        channel: which judges it.
        delays: of those sensors of the channel whose clocks are their own.
        sensors: the models of these, by name.
        seen: says where they saw the machine.
    """

    def __init__(
        self, channel: Positions | States, delays: Delays, sensors: Mapping[str, Any], seen: SeenInWorld
    ) -> None:
        self._channel, self._delays, self._sensors, self._seen = channel, delays, sensors, seen

    def add(self, graph: DualGraph, measurement: Any, now_ns: int) -> Outcome:
        """Let a measurement be judged, and look whether what is refused is late."""
        outcome, name = self._channel.add(graph, measurement, now_ns), measurement.sensor
        if name in self._delays and outcome is not Outcome.LATE:
            seen = self._seen(self._sensors[name], measurement, graph.published)
            is_refused = outcome is not Outcome.USED or name in self._channel.lost()
            self._delays.look(graph, name, seen, is_refused=is_refused)
        return outcome


def late_receivers(
    sensors: Mapping[str, PositionSensor], positions: Positions, log: EventLog, date_later: DateLater
) -> LateSensors:
    """Return what looks after receivers of positions; those of GNSS have its clock."""
    clocked: dict[str, Any] = {
        name: one for name, one in sensors.items() if has_estimated_clock(one) and not is_gnss(one)
    }
    clocks = {name: one.parameters[-1] for name, one in clocked.items()}
    return LateSensors(positions, Delays(clocked, clocks, _far_delay, log, date_later), clocked, _position_in_world)


def late_poses(sensors: Mapping[str, StateSensor], states: States, log: EventLog, date_later: DateLater) -> LateSensors:
    """Return what looks after poses in the world; no graph estimates their clocks."""
    return LateSensors(states, Delays(sensors, {}, _far_delay, log, date_later), sensors, _pose_in_world)


def _far_delay() -> FarDelay:
    return FarDelay(BESIDE_M, is_angle=False, left=LEFT_M)


def _position_in_world(sensor: Any, position: Position, smoother: Smoother) -> Seen:
    nav = smoother.nav(position.stamp_ns)
    expected = nav.position() + nav.attitude().rotate(sensor.p_I_P)
    return Seen(position.stamp_ns, position.p_W_P, _sigma(position.covariance), expected)


def _pose_in_world(sensor: StateSensor, pose: FramePose, smoother: Smoother) -> Seen:
    found = residual(sensor, pose, smoother)
    assert not isinstance(found, Outcome)  # every pose is compared
    nav = smoother.nav(pose.stamp_ns)
    measured = nav.position() + nav.attitude().rotate(found.y[3:])
    return Seen(pose.stamp_ns, measured, _sigma(pose.covariance[3:, 3:]), nav.position())


def _sigma(covariance: Array) -> float:
    return float(np.sqrt(np.trace(covariance)))
