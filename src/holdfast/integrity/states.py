"""Measurements that one state explains, on their way into the graphs: tested one by one, with hysteresis."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import pairwise

import gtsam

from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.sensor_parameters import with_parameters
from holdfast.graph.smoother import Smoother
from holdfast.integrity.innovation import Change, InnovationGate
from holdfast.integrity.noise_scale import LOWEST, NoiseScale
from holdfast.integrity.residual import residual
from holdfast.measured_fields import NEVER_NS
from holdfast.sensors.coloured import Compared, coloured, coloured_factor
from holdfast.sensors.noise import Colour, correlation_inflation, shared_inflation
from holdfast.sensors.sensor import ConstraintSensor, Innovation, Joint, Measurement, Role, State, StateSensor

LOWEST_VELOCITY = 0.25  # of the variance that a receiver claims of its Doppler velocity

JointAt = Callable[[int], Joint | None]
"""Returns the turn joint at a time [ns], None where its angle is not known."""


class JudgedSensor:
    """One sensor whose measurements are compared with a state, weighed by their correlation, and trusted or not.

    Args:
        sensor: its model.
        scale: of its noise.
        joint_at: tells the turn joint.
        log: where counts and events go.
    """

    def __init__(self, sensor: StateSensor, scale: NoiseScale, joint_at: JointAt, log: EventLog) -> None:
        self.gate = InnovationGate(sensor.settings, can_fall_silent=not isinstance(sensor, ConstraintSensor))
        self._sensor, self.role = sensor, sensor.role
        self._joint_at = joint_at
        self._log = log
        self._used_ns = NEVER_NS
        self._scale = scale

    def judge(
        self,
        measurement: Measurement,
        judge: Smoother,
        smoothers: Iterable[Smoother],
        now_ns: int,
        inflation: float | None = None,
    ) -> Outcome:
        """Test a measurement at its node of one smoother, and add its factor to all of them if it may enter.

        Args:
            measurement: in the order of stamps.
            judge: whose state it is compared with.
            smoothers: into which it enters.
            now_ns: time that the IMU has reached.
            inflation: factor on its covariance; without it, that of one measurement after the last.
        """
        found = self._compare(judge, measurement)
        nis = found if isinstance(found, Outcome) else found.innovation.nis(found.state)
        outcome = self.gate.judge(measurement, nis, now_ns)
        if outcome is Outcome.USED:
            if inflation is None:
                since_s = abs(measurement.stamp_ns - self._used_ns) * 1e-9
                inflation = correlation_inflation(self._correlation_s(measurement), since_s)
            known = None if isinstance(found, Outcome) else found
            self._enter(measurement, smoothers, inflation, judge, known)
        elif outcome is not Outcome.QUARANTINED:
            self._log.report(EventKind.REJECTED, measurement.stamp_ns, measurement.sensor, outcome)
        if not (isinstance(found, Outcome) or self.gate.is_lost):
            self._learn(measurement, found, judge)
        tested = () if isinstance(nis, Outcome) or isinstance(found, Outcome) else (nis, len(found.innovation.y))
        self._log.record(measurement.stamp_ns, measurement.sensor, outcome, *tested, limit=self.gate.limit)
        return outcome

    def held_inflation(self, held: Sequence[Measurement]) -> float:
        """Return the factor on the covariance of each of some measurements that enter at once."""
        if not held:
            return 1.0
        gaps_s = [abs(b.stamp_ns - a.stamp_ns) * 1e-9 for a, b in pairwise(held)]
        since_s = abs(held[0].stamp_ns - self._used_ns) * 1e-9
        return shared_inflation(self._correlation_s(held[0]), [since_s, *gaps_s])

    def _correlation_s(self, measurement: Measurement) -> float:
        """Return the correlation time of the errors of a measurement, or of what is white of them."""
        colour = _colour(measurement)
        return self._sensor.settings.correlation_s if colour is None else colour.white_correlation_s

    def review(self, smoothers: Iterable[Smoother], now_ns: int) -> None:
        """Lose the sensor or regain it; what waited enters when it is regained."""
        change, name = self.gate.review(now_ns), self._sensor.name
        if change is Change.LOST:
            self._log.report(EventKind.SENSOR_LOST, now_ns, name, self.gate.reason())
        elif change is Change.REGAINED:
            held, every = self.gate.take_quarantined(), list(smoothers)
            inflation = self.held_inflation(held)
            for measurement in held:
                if self._enter(measurement, every, inflation):
                    self._log.recount(name, Outcome.QUARANTINED, Outcome.USED)
                    self._log.record(measurement.stamp_ns, name, Outcome.USED)
            self._log.report(EventKind.SENSOR_REGAINED, now_ns, name, f"{len(held)} good measurements in a row")

    def _learn(self, measurement: Measurement, found: Compared, smoother: Smoother) -> None:
        """Learn the noise of the sensor from a measurement."""
        claimed = found.innovation._replace(R=found.innovation.R / self._scale.above)
        lowest = LOWEST_VELOCITY if self._sensor.role is Role.VELOCITY else LOWEST
        colour = _colour(measurement)
        if colour is not None:
            self._scale.white.learn(self._sensor, measurement, colour, smoother, found.state)
        self._scale.learn(claimed, found.state, measurement, self._log, lowest)

    def residual(self, smoother: Smoother, measurement: Measurement) -> Innovation | Outcome:
        """Compare a measurement that has a node with a smoother's estimate, whatever that is worth."""
        return residual(self._sensor, measurement, smoother, self._joint_at(measurement.stamp_ns))

    def _compare(self, smoother: Smoother, measurement: Measurement) -> Compared | Outcome:
        key, stamp_ns = smoother.node(measurement.stamp_ns), measurement.stamp_ns
        if key is None:
            return Outcome.LATE
        parameter_keys, state = self._state(smoother, measurement)
        innovation = self._sensor.innovation(measurement, state)
        if isinstance(innovation, Outcome):
            return innovation
        keys, innovation = [key, *parameter_keys], innovation._replace(R=innovation.R * self._scale.above)
        colour = _colour(measurement)
        if colour is None:
            return Compared(keys, state, innovation)
        slow = smoother.slow_error(measurement.sensor, colour, stamp_ns)
        return coloured(keys, state, innovation, self._scale.white.colour(colour, self._scale.above), slow)

    def _enter(
        self,
        measurement: Measurement,
        smoothers: Iterable[Smoother],
        inflation: float,
        judge: Smoother | None = None,
        known: Compared | None = None,
    ) -> bool:
        """Add the factor of a measurement to smoothers; to one of them it may have been compared already."""
        has_entered = False
        for smoother in smoothers:
            found = known if known is not None and smoother is judge else self._compare(smoother, measurement)
            if not isinstance(found, Outcome):
                smoother.enter(measurement, self._factor(smoother, measurement, found, inflation))
                self._used_ns, has_entered = measurement.stamp_ns, True
        return has_entered

    def _factor(
        self, smoother: Smoother, measurement: Measurement, found: Compared, inflation: float
    ) -> gtsam.NonlinearFactor:
        if found.slow is not None:
            return coloured_factor(self._sensor, measurement, found, found.slow, inflation, new=smoother.new)
        scale = inflation * self._scale.value
        claimed = found.innovation._replace(R=found.innovation.R / self._scale.above)
        return self._sensor.factor(found.keys, measurement, found.state, claimed, scale)

    def _state(self, smoother: Smoother, measurement: Measurement) -> tuple[list[int], State]:
        stamp_ns = measurement.stamp_ns
        state = smoother.state_at(stamp_ns, self._joint_at(stamp_ns))
        start = self._sensor.first_parameter(measurement, state)
        return with_parameters(smoother, self._sensor, state, stamp_ns, start)


def _colour(measurement: Measurement) -> Colour | None:
    """Return the colour of the error of a measurement, if its slow part is estimated."""
    colour: Colour | None = getattr(measurement, "colour", None)
    return colour


class States:
    """All sensors of role STATE of one machine; they enter both graphs alike.

    Args:
        sensors: the models, by name.
        scales: of their noise, by name.
        joint_at: tells the turn joint.
        log: where counts and events go.
    """

    def __init__(
        self, sensors: dict[str, StateSensor], scales: Mapping[str, NoiseScale], joint_at: JointAt, log: EventLog
    ) -> None:
        self._judged = {name: JudgedSensor(sensor, scales[name], joint_at, log) for name, sensor in sensors.items()}

    def lost(self) -> list[str]:
        """Return the sensors that are not trusted."""
        return [name for name, judged in self._judged.items() if judged.gate.is_lost]

    def agreeing(self, role: Role) -> set[str]:
        """Return the sensors of a role that are trusted and do not contradict the state."""
        judged = ((name, one.gate) for name, one in self._judged.items() if one.role is role)
        return {name for name, gate in judged if not gate.is_lost and not gate.contradicts}

    def contradicting(self, role: Role) -> set[str]:
        """Return the sensors of a role that have contradicted the state several times in a row."""
        return {name for name, one in self._judged.items() if one.role is role and one.gate.contradicts}

    def hold(self, wrong: Collection[str]) -> None:
        """Keep these sensors, and no others, out of the graphs whatever their measurements look like."""
        for name, judged in self._judged.items():
            judged.gate.hold(is_wrong=name in wrong)

    def add(self, graph: DualGraph, measurement: Measurement, now_ns: int) -> Outcome:
        """Judge a measurement at its node, and add its factor to the graphs if it may enter."""
        judged = self._judged[measurement.sensor]
        return judged.judge(measurement, graph.published, graph.smoothers(), now_ns)

    def pass_over(self, gap_ns: int) -> None:
        """Know that the IMU has not measured for so long."""
        for judged in self._judged.values():
            judged.gate.pass_over(gap_ns)

    def review(self, graph: DualGraph, now_ns: int) -> None:
        """Lose and regain sensors."""
        for judged in self._judged.values():
            judged.review(graph.smoothers(), now_ns)
