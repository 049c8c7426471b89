"""Sensors with a clock of their own that send what they measured seconds ago: a total station's prism, markers.

Beside an odometry the estimate leaves such positions while the machine moves, and finds them again where it stands.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.sensor_parameters import with_beliefs
from holdfast.graph.smoother import Smoother
from holdfast.integrity.far_delay import DateLater, FarDelay, date_anew, is_far, told
from holdfast.integrity.positions import Positions
from holdfast.integrity.receiver import Trust
from holdfast.integrity.states import States
from holdfast.messages import Array
from holdfast.sensors.clock import has_estimated_clock
from holdfast.sensors.pose import FramePose
from holdfast.sensors.sensor import Position, PositionSensor, StateSensor, is_gnss

BESIDE_M = 0.05  # by which positions that are late are beside the estimate at least, in the mean
LEFT_M = 0.3  # by which the estimate may have been drawn astray by them


class _Seen(NamedTuple):
    """A position (3,) in W, the noise in all of it, and where the estimate expected it [m]."""

    p_W: Array
    sigma: float
    expected_W: Array


class _Delays:
    """Looks for delays of some sensors that are no state of a graph, and dates anew what those say."""

    def __init__(self, sensors: Mapping[str, Any], log: EventLog, date_later: DateLater) -> None:
        self.sensors = sensors
        self._late = {name: FarDelay(BESIDE_M, is_angle=False, left=LEFT_M) for name in sensors}
        self._log, self._date_later = log, date_later

    def look(self, graph: DualGraph, name: str, stamp_ns: int, seen: _Seen, *, is_doubtful: bool) -> None:
        """Take in what a sensor says, and where that is in doubt look whether it is late."""
        late = self._late[name]
        late.note(stamp_ns, *seen)
        if not is_doubtful or (delay_s := late.delay_s()) is None:
            return
        self._log.report(EventKind.CALIBRATION, stamp_ns, name, told(delay_s))
        date_anew(self.sensors[name], late, delay_s, graph, self._date_later)


class LateReceivers:
    """Dates anew the positions of receivers that are late or early by far; those of GNSS have its clock.

    Args:
        sensors: the models, by name.
        positions: which judges them.
        log: where events go.
        date_later: reads stamps of sensors as so much later [ns], those that will come.
    """

    def __init__(
        self, sensors: Mapping[str, PositionSensor], positions: Positions, log: EventLog, date_later: DateLater
    ) -> None:
        clocked = {name: one for name, one in sensors.items() if has_estimated_clock(one) and not is_gnss(one)}
        self._delays, self._positions = _Delays(clocked, log, date_later), positions

    def add(self, graph: DualGraph, position: Position, now_ns: int) -> Outcome:
        """Let a position be judged, and look whether what is refused is late."""
        outcome, name = self._positions.add(graph, position, now_ns), position.sensor
        if (sensor := self._delays.sensors.get(name)) is not None and outcome is not Outcome.LATE:
            nav = graph.published.nav(position.stamp_ns)
            expected = nav.position() + nav.attitude().rotate(sensor.p_I_P)
            seen = _Seen(position.p_W_P, _sigma(position.covariance), expected)
            is_refused = outcome is not Outcome.USED or self._positions.gates[name].trust is Trust.LOST
            is_doubtful = is_refused or is_far(graph, name, sensor.parameters[-1])
            self._delays.look(graph, name, position.stamp_ns, seen, is_doubtful=is_doubtful)
        return outcome


class LatePoses:
    """Dates anew poses in the world that are late or early by far.

    Args:
        sensors: the models, by name.
        states: which judges them.
        log: where events go.
        date_later: reads stamps of sensors as so much later [ns], those that will come.
    """

    def __init__(
        self, sensors: Mapping[str, StateSensor], states: States, log: EventLog, date_later: DateLater
    ) -> None:
        self._delays, self._states = _Delays(sensors, log, date_later), states

    def add(self, graph: DualGraph, pose: FramePose, now_ns: int) -> Outcome:
        """Let a pose be judged, and look whether what is refused is late."""
        outcome, name = self._states.add(graph, pose, now_ns), pose.sensor
        if outcome is not Outcome.LATE and (seen := self._seen(graph.published, pose)) is not None:
            is_doubtful = outcome is not Outcome.USED or name in self._states.lost()
            self._delays.look(graph, name, pose.stamp_ns, seen, is_doubtful=is_doubtful)
        return outcome

    def _seen(self, smoother: Smoother, pose: FramePose) -> _Seen | None:
        sensor = self._delays.sensors[pose.sensor]
        state = with_beliefs(smoother, sensor, smoother.mean_at(pose.stamp_ns))
        innovation = sensor.innovation(pose, state)
        if isinstance(innovation, Outcome):
            return None
        expected = state.nav.position()
        return _Seen(
            expected + state.nav.attitude().rotate(innovation.y[3:]), _sigma(pose.covariance[3:, 3:]), expected
        )


def _sigma(covariance: Array) -> float:
    return float(np.sqrt(np.trace(covariance)))
