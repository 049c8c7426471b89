"""Receivers that are no antennas, such as a total station's prism, and send what they measured seconds ago.

Beside an odometry the estimate leaves such positions while the machine moves, and finds them again where it stands.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.graph.dual_graph import DualGraph
from holdfast.integrity.far_delay import DateLater, FarDelay, date_anew, is_far, told
from holdfast.integrity.positions import Positions
from holdfast.integrity.receiver import Trust
from holdfast.sensors.clock import has_estimated_clock
from holdfast.sensors.sensor import Position, PositionSensor, is_gnss

BESIDE_M = 0.05  # by which positions that are late are beside the estimate at least, in the mean
LEFT_M = 0.3  # by which the estimate may have been drawn astray by them


class LateReceivers:
    """Dates anew what receivers say that are late or early by far; those of GNSS have their own clock.

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
        self._sensors: dict[str, Any] = dict(clocked)
        self._late = {name: FarDelay(BESIDE_M, is_angle=False, left=LEFT_M) for name in clocked}
        self._positions, self._log, self._date_later = positions, log, date_later

    def add(self, graph: DualGraph, position: Position, now_ns: int) -> Outcome:
        """Let a position be judged, and look whether what is refused is late."""
        outcome = self._positions.add(graph, position, now_ns)
        if position.sensor in self._late and outcome is not Outcome.LATE:
            self._look_whether_late(graph, position, is_refused=outcome is not Outcome.USED)
        return outcome

    def _look_whether_late(self, graph: DualGraph, position: Position, *, is_refused: bool) -> None:
        name, stamp_ns = position.sensor, position.stamp_ns
        sensor, late, nav = self._sensors[name], self._late[name], graph.published.nav(stamp_ns)
        expected = nav.position() + nav.attitude().rotate(sensor.p_I_P)
        late.note(stamp_ns, position.p_W_P, float(np.sqrt(np.trace(position.covariance))), expected)
        is_lost = self._positions.gates[name].trust is Trust.LOST
        is_doubtful = is_refused or is_lost or is_far(graph, name, sensor.parameters[-1])
        if not is_doubtful or (delay_s := late.delay_s()) is None:
            return
        self._log.report(EventKind.CALIBRATION, stamp_ns, name, told(delay_s))
        date_anew(sensor, late, delay_s, graph, self._date_later)
