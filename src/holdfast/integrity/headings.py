"""Headings on their way into the main graph: tested as all states are, and held back while GNSS is lost.

They come from the receiver whose fixes are doubted, so while GNSS is lost they wait in quarantine; those of its
recovery enter together with the fixes, and the heading of the world is corrected once.

What is refused because it is mounted otherwise than configured is let go from there, and comes back; what is dated
seconds late is dated anew.
"""

from collections import deque
from collections.abc import Mapping
from math import radians, remainder, sqrt, tau
from typing import Any

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.smoother import Smoother
from holdfast.integrity.far_delay import DateLater, Delays, FarDelay, Seen
from holdfast.integrity.noise_scale import NoiseScale
from holdfast.integrity.states import JudgedSensor
from holdfast.integrity.turned_headings import TurnedHeadings
from holdfast.integrity.yaw_learning import WITNESS_NS, Witness
from holdfast.sensors.clock import DELAY
from holdfast.sensors.heading import MOUNT, AxisYaw
from holdfast.sensors.sensor import StateSensor, part_of

BESIDE_RAD = radians(1.0)  # by which headings that are late are beside the estimate at least, in the mean
WITNESSES = 32  # how many are remembered
MIRRORED = "it turns the other way than the machine: `clockwise` is not as configured"


class Headings:
    """All headings of one machine.

    Args:
        sensors: the models, by name.
        scales: of their noise, by name.
        log: where counts and events go.
        date_later: reads stamps of sensors as so much later [ns], those that will come.
    """

    def __init__(
        self,
        sensors: dict[str, StateSensor],
        scales: Mapping[str, NoiseScale],
        log: EventLog,
        date_later: DateLater,
    ) -> None:
        self._sensors: dict[str, Any] = dict(sensors)
        self._judged = {
            name: JudgedSensor(sensor, scales[name], lambda _: None, log) for name, sensor in sensors.items()
        }
        self._mounts = {
            name: mount for name, sensor in sensors.items() if (mount := part_of(sensor.parameters, MOUNT)) is not None
        }
        self._runs = {name: (TurnedHeadings(), TurnedHeadings()) for name in self._mounts}  # turned, and mirrored
        clocked = {name: sensor for name, sensor in self._sensors.items() if sensor.offset_sigma_s > 0.0}
        parts = {name: part_of(sensor.parameters, DELAY) for name, sensor in clocked.items()}
        delays = {name: delay for name, delay in parts.items() if delay is not None}
        self._delays = Delays(clocked, delays, lambda: FarDelay(BESIDE_RAD, is_angle=True), log, date_later)
        self._quarantine: deque[AxisYaw] = deque()
        self._used: deque[AxisYaw] = deque(maxlen=WITNESSES)
        self._told: set[str] = set()
        self._log = log

    def lost(self) -> list[str]:
        """Return the headings that are not trusted."""
        return [name for name, judged in self._judged.items() if judged.gate.is_lost]

    def forget_window(self) -> None:
        """Forget what waits: the graph lost its window, or the estimate is moved."""
        self._quarantine.clear()

    def add(self, graph: DualGraph, heading: AxisYaw, now_ns: int) -> Outcome:
        """Judge a heading at its node, and add its factor to the main graph if it may enter."""
        judged, smoother = self._judged[heading.sensor], graph.published
        if smoother.node(heading.stamp_ns) is None:
            self._log.record(heading.stamp_ns, heading.sensor, Outcome.LATE)
            return Outcome.LATE
        if not graph.is_lost:
            outcome = judged.judge(heading, graph.main, [graph.main], now_ns)
            if outcome is Outcome.USED:
                self._used.append(heading)
            is_refused = outcome is Outcome.INNOVATION
            if heading.sensor in self._delays:
                self._look_whether_late(graph, heading, is_refused=is_refused)
            if heading.sensor in self._mounts:
                self._look_whether_turned(graph, heading, is_refused=is_refused)
            return outcome
        judged.gate.note(heading, now_ns)
        while self._quarantine and self._quarantine[0].stamp_ns < smoother.oldest_ns:
            self._quarantine.popleft()
        self._quarantine.append(heading)
        self._log.record(heading.stamp_ns, heading.sensor, Outcome.QUARANTINED)
        return Outcome.QUARANTINED

    def _look_whether_late(self, graph: DualGraph, heading: AxisYaw, *, is_refused: bool) -> None:
        """Read the stamps of a sensor by another clock, if its headings are refused because they are seconds late."""
        attitude, name = graph.main.nav(heading.stamp_ns).attitude(), heading.sensor
        if (found := self._sensors[name].of_imu(heading, attitude)) is not None:
            seen = Seen(heading.stamp_ns, heading.yaw_rad, heading.sigma_rad, heading.yaw_rad - found[0])
            self._delays.look(graph, name, seen, is_refused=is_refused)

    def _look_whether_turned(self, graph: DualGraph, heading: AxisYaw, *, is_refused: bool) -> None:
        """Let the mounting of a sensor go, if its headings are refused for that alone; tell one that is a mirror."""
        name = heading.sensor
        turned, mirrored = self._runs[name]
        found = self._judged[name].residual(graph.main, heading) if is_refused else Outcome.USED
        if isinstance(found, Outcome):
            turned.clear()
            mirrored.clear()
            return
        mount = self._mounts[name]
        believed_rad = float(graph.main.parameters.belief(mount.name(name), mount)[0][0])
        off_rad, sigma_rad = float(found.y[0]) + believed_rad, sqrt(float(found.R[0, 0]))
        yaw_rad = heading.yaw_rad - off_rad
        if (angle_rad := turned.note(off_rad, sigma_rad, yaw_rad)) is not None:
            turned.clear()
            graph.let_parameter_go(mount.name(name), np.array([angle_rad]))
        if mirrored.note(heading.yaw_rad + yaw_rad, sigma_rad, yaw_rad) is not None and name not in self._told:
            self._told.add(name)
            self._log.report(EventKind.CALIBRATION, heading.stamp_ns, name, MIRRORED)

    def witness(self, smoother: Smoother, stamp_ns: int) -> Witness | None:
        """Return what the headings that were used near a time say of the estimate; None where there are none."""
        beyond_rad, variances = [], []
        for heading in self._used:
            if abs(heading.stamp_ns - stamp_ns) > WITNESS_NS or not smoother.has_node(heading.stamp_ns):
                continue
            found = self._judged[heading.sensor].residual(smoother, heading)
            if not isinstance(found, Outcome):
                beyond_rad.append(remainder(float(found.y[0]), tau))
                variances.append(float(found.R[0, 0]))
        return Witness.of(beyond_rad, variances)

    def admit(self, trial: Smoother, since_ns: int, now_ns: int) -> bool:
        """Let the headings since a time out of quarantine, into a smoother that has just accepted the fixes since then.

        Each is judged by what the fixes have made of the estimate.

        Returns:
            Whether any entered, so that the smoother has to be optimised again.
        """
        held = [heading for heading in self._quarantine if heading.stamp_ns >= since_ns]
        self._quarantine.clear()
        outcomes = []
        for name, judged in self._judged.items():
            of_one = [heading for heading in held if heading.sensor == name]
            inflation = judged.held_inflation(of_one)
            for heading in of_one:
                outcomes.append(judged.judge(heading, trial, [trial], now_ns, inflation))
                self._log.recount(name, Outcome.QUARANTINED, outcomes[-1])
        return Outcome.USED in outcomes

    def pass_over(self, gap_ns: int) -> None:
        """Know that the IMU has not measured for so long."""
        for judged in self._judged.values():
            judged.gate.pass_over(gap_ns)

    def review(self, graph: DualGraph, now_ns: int) -> None:
        """Lose and regain headings, while the fixes of their receiver are trusted."""
        if not graph.is_lost:
            for judged in self._judged.values():
                judged.review([graph.main], now_ns)
