"""Positions of receivers on their way into the main graph: tested, weighed, and taken out again."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import inf, isfinite
from typing import NamedTuple

from holdfast.config.model import GateConfig
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.sensor_parameters import with_beliefs, with_parameters
from holdfast.graph.smoother import Smoother
from holdfast.integrity.antenna_pairs import witness_of
from holdfast.integrity.arm_knowledge import is_arm_known, is_arm_proven
from holdfast.integrity.baseline import BaselineTest
from holdfast.integrity.consensus import Consensus, Departure
from holdfast.integrity.departures import Departures
from holdfast.integrity.exchanges import Exchange, ExchangeTest
from holdfast.integrity.force_learning import ForceLearning, least_scale
from holdfast.integrity.innovation import in_words
from holdfast.integrity.learnt_snapshot import LearntScale
from holdfast.integrity.lever_arms import LeverArms
from holdfast.integrity.noise_scale import LOWEST, NoiseScale
from holdfast.integrity.receiver import Held, Prediction, ReceiverGate, Trust, predict
from holdfast.integrity.review import UsedPositions
from holdfast.integrity.yaw_learning import WITNESS_NS, Witness
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.coloured import Compared, coloured, coloured_factor
from holdfast.sensors.noise import WHITE, correlation_inflation, shared_inflation
from holdfast.sensors.sensor import Position, PositionSensor, is_gnss

RATHER = 16.0  # of the NIS: a position is of the antenna that explains it by so much better
REVIEW_NS = 250_000_000  # used positions are reviewed this often
SLOW_S, LOWEST_SLOW = 1.0, 0.01  # most of such a claim is a slow error, by which neighbours are alike
LEARNT_FROM = Outcome.USED, Outcome.INNOVATION
BENIGN = {Outcome.LOW_STATUS, Outcome.LARGE_COVARIANCE, Outcome.NO_COVARIANCE, Outcome.NOT_FINITE, Outcome.LATE}


class Contradiction(NamedTuple):
    """A receiver whose positions agree among themselves, not with the estimate, and since when they do."""

    sensor: str
    since_ns: int


class Positions:
    """All receivers of positions of one machine, antennas and prisms.

    Args:
        config: of the gates.
        sensors: the models, by name.
        scales: of their noise, by name.
        lever_arms: what is believed of them.
        log: where counts and events go.
        since_ns: when positions began to be expected.
        believe_after_s: for so long positions must agree among themselves to be right against the estimate.
        accelerometer: what was learnt of it before.
    """

    def __init__(
        self,
        config: GateConfig,
        sensors: dict[str, PositionSensor],
        scales: Mapping[str, NoiseScale],
        lever_arms: LeverArms,
        log: EventLog,
        *,
        since_ns: int,
        believe_after_s: float,
        accelerometer: LearntScale | None = None,
    ) -> None:
        self.gates = {name: ReceiverGate(config, sensor.limit, since_ns) for name, sensor in sensors.items()}
        self.used = UsedPositions(sensors)
        self._config = config
        self._sensors = sensors
        self._baseline = BaselineTest(lever_arms)
        self._exchange_test = ExchangeTest()
        self._antennas = {name for name, sensor in sensors.items() if is_gnss(sensor)}
        self._exchanged: list[Exchange] = []
        self._log = log
        self._reviewed_ns = NEVER_NS
        self.are_arms_proven = False  # whether those of antennas are as they were measured
        self._departures = {name: Departures() for name in sensors}
        self.wandering: Collection[str] = ()  # receivers that are wrong, though their positions agree with each other
        self._agreeing: set[str] = set()  # have ever been as expected; what is no antenna was used, beside one that led
        self._scales = scales
        self._force = {name: ForceLearning(accelerometer) for name in sensors}
        self.believe_after_s = believe_after_s
        self._consensus = {name: Consensus(config.regain_after, believe_after_s) for name in sensors}

    @property
    def is_trusted(self) -> bool:
        """Whether at least one receiver is trusted."""
        return any(gate.trust is Trust.TRUSTED for gate in self.gates.values())

    @property
    def lead(self) -> bool:
        """Whether those of at least one receiver lead the estimate."""
        return any(gate.leads for gate in self.gates.values())

    @property
    def have_jumped(self) -> bool:
        """Whether the fixes of all lost receivers have moved faster than a machine: then it is them that changed."""
        lost = [gate for gate in self.gates.values() if gate.trust is Trust.LOST]
        return bool(lost) and all(gate.reasons[Outcome.TOO_FAST] for gate in lost)

    def be_patient(self, believe_after_s: float) -> None:
        """From now on positions must agree among themselves for so long to be right against the estimate [s]."""
        self.believe_after_s = believe_after_s
        for run in self._consensus.values():
            run.duration_s = believe_after_s

    def lost(self) -> list[str]:
        """Return the receivers that are not trusted."""
        return [name for name, gate in self.gates.items() if gate.trust is Trust.LOST]

    def distrust(self, names: Collection[str]) -> None:
        """Trust those receivers no more that are among some sensors, until their positions are right for a while."""
        for name, gate in self.gates.items():
            if name in names:
                gate.become(Trust.LOST, hold_s=self._config.regain_s)

    def leave_out(self, names: Collection[str]) -> None:
        """Begin without them."""
        self.distrust(names)
        self._agreeing.update(self._antennas - set(names))  # the start has shown that

    def regained(self) -> list[str]:
        """Return the lost receivers whose positions the estimate has expected for long enough to trust them again.

        One that is elsewhere is expected by an estimate that has drifted as far: only beside another it is.
        """
        ready = [name for name, gate in self.gates.items() if gate.regains()]
        elsewhere = frozenset[str]() if self.lead else self.misplaced
        self.distrust(elsewhere.intersection(ready))
        return [name for name in ready if name not in elsewhere]

    def newly_exchanged(self) -> list[Exchange]:
        """Return which antennas have been found to be each where the other is expected, since this was asked last."""
        found, self._exchanged = self._exchanged, []
        return found

    @property
    def misplaced(self) -> frozenset[str]:
        """The receivers beside GNSS that have never agreed with it: somebody has typed where they stand."""
        if self._agreeing.isdisjoint(self._antennas):
            return frozenset()
        never = self.gates.keys() - self._antennas - self._agreeing
        return frozenset(name for name in never if self.gates[name].trust is Trust.LOST)

    @property
    def disbelieved(self) -> set[str]:
        """The receivers whose positions are wrong, though they agree with each other."""
        return {*self.wandering, *self.misplaced}

    def refuse(self, sensor: str, outcome: Outcome) -> None:
        """Note a position that the receiver itself reports as bad."""
        if outcome in BENIGN:
            self.gates[sensor].refuse(outcome)

    def add(self, graph: DualGraph, position: Position, now_ns: int) -> Outcome:
        """Judge a position at its node, and add its factor to the main graph if it may enter."""
        smoother, name = graph.published, position.sensor
        if (key := smoother.node(position.stamp_ns)) is None:
            self._log.record(position.stamp_ns, name, Outcome.LATE, p_W_P=position.p_W_P)
            return Outcome.LATE
        gate, scale = self.gates[name], self._scales[name]
        above, claimed = scale.above, position
        colour = None if position.colour is None else scale.white.colour(position.colour, above)
        position = replace(position, covariance=position.covariance * above, colour=colour)
        found = self._compare(smoother, key, position)
        innovation, state = found.innovation, found.state
        prediction = predict(innovation, state)
        others = list[str]()
        if name in self._antennas:
            others = self._expected_instead(smoother, position, prediction)
            is_at_home = prediction.nis <= gate.limit and not others
            self._exchanged += self._exchange_test.note(position, others, is_expected=is_at_home)
        worse = None
        if self._config.baseline:
            worse = self._baseline.contradicted(position, prediction.nis, state.nav.attitude())
        if worse is not None and worse is not position:
            self.gates[worse.sensor].refuse(Outcome.BASELINE)
            if worse in self.used.of(worse.sensor):
                self.take_out(graph.main, worse, Outcome.BASELINE)
        is_apart = worse is not position and not others  # from the other antennas, as it is mounted
        outcome = gate.judge(position, prediction, now_ns=now_ns, baseline_agrees=is_apart)
        is_refused = outcome not in (Outcome.USED, Outcome.QUARANTINED)
        if (self.lead and outcome is Outcome.USED) or (name in self._antennas and not is_refused):
            self._agreeing.add(name)
        self._consensus[name].add(position, outcome, innovation.y, is_expected=prediction.nis <= gate.limit)
        self._note_departure(claimed, prediction.innovation, scale, is_refused=is_refused)
        if (
            gate.trust is Trust.TRUSTED
            and outcome in LEARNT_FROM
            and is_arm_known(self._sensors[name], state, innovation.R)
        ):
            lowest = LOWEST_SLOW if position.correlation_s >= SLOW_S and found.slow is None else LOWEST
            scale.learn(innovation._replace(R=innovation.R / above), state, position, self._log, lowest)
        if outcome is Outcome.USED:
            self._learn_force(graph, claimed, found)
            if position.colour is not None:
                sensor, white = self._sensors[name], scale.white
                white.learn(sensor, position, position.colour, smoother, state, scale.above)
            correlated = correlation_inflation(_correlation_s(position), self.used.since_last_s(position))
            inflation = gate.inflation(prediction) * correlated
            if self._enter(graph.main, position, inflation, found if smoother is graph.main else None):
                self.used.add(position)
        elif outcome is not Outcome.QUARANTINED:
            if gate.trust is Trust.TRUSTED:
                graph.main.parameters.doubt(position.stamp_ns)
            self._log.report(EventKind.REJECTED, position.stamp_ns, name, outcome)
        limit, p_W_P = gate.limit_on_nis, position.p_W_P
        self._log.record(position.stamp_ns, name, outcome, prediction.nis, 3, limit=limit, p_W_P=p_W_P)
        return outcome

    def _expected_instead(self, smoother: Smoother, position: Position, prediction: Prediction) -> list[str]:
        """Return the other antennas that are expected where a position is, far rather than its own."""
        enough, found = min(self.gates[position.sensor].limit, prediction.nis - RATHER), list[str]()
        if enough <= 0.0:
            return found
        for name in self._antennas - {position.sensor}:
            sensor = self._sensors[name]
            state = with_beliefs(smoother, sensor, smoother.state_at(position.stamp_ns))
            if predict(sensor.innovation(position, state), state).nis <= enough:
                found.append(name)
        return found

    def _note_departure(self, claimed: Position, off_W: Array, scale: NoiseScale, *, is_refused: bool) -> None:
        """Note how far a position is from the estimate; those that depart smoothly again are worth what they claim."""
        name = claimed.sensor
        if not (is_refused or scale.is_raised):
            self._departures[name].clear()
            return
        self._departures[name].add(claimed.stamp_ns, off_W, claimed.covariance * scale.above_learnt)
        if scale.is_raised and self._departures[name].are_smooth():
            scale.lower()

    def learnt_accelerometer(self) -> LearntScale | None:
        """Return what is known of the accelerometer; None where nothing is."""
        known = [found for one in self._force.values() if (found := one.learnt()) is not None]
        return min(known, key=lambda one: one.log_mean, default=None)

    def _learn_force(self, graph: DualGraph, claimed: Position, found: Compared) -> None:
        """Learn from a position that was used what the accelerometer is worth; such as are not resolved jump."""
        if claimed.correlation_s >= SLOW_S or graph.published is not graph.main:
            return
        self._force[claimed.sensor].learn(graph.main, claimed, found.residual, claimed.colour or WHITE)
        graph.main.imu_noise.force_scale = least_scale(self._force.values())

    def heading_witness(self, smoother: Smoother, stamp_ns: int) -> Witness | None:
        """Return what pairs of antennas near a time say of the heading of an estimate; None where there are none."""
        return witness_of(self._sensors, self.used.of(since_ns=stamp_ns - WITNESS_NS), smoother, stamp_ns)

    def enter_held(self, smoother: Smoother, held: Sequence[Held], *, is_trial: bool) -> list[Position]:
        """Let positions that waited enter a smoother, and return them.

        Those of one receiver weigh the same, or the first would say more than all others. The window of a trial holds
        no others, whatever the main graph holds.
        """
        entered = []
        for name in self._sensors:
            positions = [one.position for one in held if one.position.sensor == name]
            if not positions:
                continue
            before_s = inf if is_trial else self.used.since_last_s(positions[0])
            gaps_s = [(b.stamp_ns - a.stamp_ns) * 1e-9 for a, b in pairwise(positions)]
            correlation_s = max(_correlation_s(one) for one in positions)
            inflation = shared_inflation(correlation_s, [before_s, *gaps_s])
            entered += [one for one in positions if self._enter(smoother, one, inflation)]
        return entered

    def take_out(self, smoother: Smoother, position: Position, outcome: Outcome) -> None:
        """Take a used position out of the main graph again."""
        self.used.remove(position)
        smoother.retract(position)
        self._log.recount(position.sensor, Outcome.USED, outcome)
        self._log.record(position.stamp_ns, position.sensor, outcome)
        self._log.report(EventKind.REJECTED, position.stamp_ns, position.sensor, outcome)

    def take_out_all(self, smoother: Smoother, outcome: Outcome) -> None:
        """Take every used position out of the main graph again."""
        for position in self.used.of():
            self.take_out(smoother, position, outcome)

    def pass_over(self, gap_ns: int) -> None:
        """Know that the IMU has not measured for so long."""
        for gate in self.gates.values():
            gate.pass_over(gap_ns)

    def review(self, smoother: Smoother) -> None:
        """After an optimisation of the main graph: take out the position that later ones contradict most."""
        self.used.forget_before(smoother.oldest_ns)
        if self._config.innovation and len(self.used) and self.used.newest_ns - self._reviewed_ns >= REVIEW_NS:
            self._reviewed_ns = self.used.newest_ns
            if not self.are_arms_proven:
                self.are_arms_proven = any(is_arm_proven(sensor, smoother) for sensor in self._sensors.values())
            worst = self.used.worst(smoother, {name: self._quarantine_ns(name) for name in self.gates})
            if worst is not None:
                self._consensus[worst.sensor].contradict(worst)
                self.take_out(smoother, worst, Outcome.CONTRADICTED)

    def suspects(self) -> dict[str, int]:
        """Return since when the estimate has refused all positions of receivers that are in place, more than one."""
        elsewhere = self.misplaced
        runs = [(name, run) for name, run in self._consensus.items() if name not in elsewhere]
        return {name: run.since_ns for name, run in runs if run.is_suspicious() or run.is_against()}

    @property
    def are_unexpected(self) -> bool:
        """Whether the newest positions of all receivers agree among themselves, not with the estimate."""
        runs = self._credible_runs()
        return bool(runs) and all(run.is_unexpected for run in runs.values())

    def is_rough(self, name: str) -> bool:
        """Whether the positions of a receiver depart from the estimate otherwise than from one that is wrong."""
        return self._departures[name].are_rough()

    def contradiction(self, *, has_witness: bool = False) -> Contradiction | None:
        """Return whose positions agree among themselves, not with the estimate; None if another receiver leads it.

        Fewer are enough where there is a witness.
        """
        runs = self._credible_runs().items()
        against = {n: run.since_ns for n, run in runs if run.is_against() or (has_witness and run.is_suspicious())}
        others = (gate for name, gate in self.gates.items() if name not in against)
        if not against or any(gate.leads for gate in others):
            return None
        return Contradiction(*next(iter(against.items())))

    def departure(self) -> Departure | None:
        """Return how the estimate leaves the positions of a receiver faster than these walk, if it does."""
        found = (run.departure() for run in self._credible_runs().values())
        return next((one for one in found if one is not None), None)

    def _credible_runs(self) -> dict[str, Consensus]:
        """Return the runs of the receivers that may be right against the estimate."""
        disbelieved = self.disbelieved
        return {name: run for name, run in self._consensus.items() if name not in disbelieved}

    def doubt(self, name: str) -> None:
        """Believe a receiver whose positions wander only as far as their distance from the estimate shows."""
        self._scales[name].raise_to(self._departures[name].excess)

    def lose_due(self, smoother: Smoother, now_ns: int) -> None:
        """Lose the receivers that are silent or had too many bad positions in a row."""
        for name, gate in self.gates.items():
            if gate.loses(now_ns):
                self._lose(smoother, name, gate, now_ns)

    def forget_window(self) -> None:
        """The graph lost its window, and with it every factor."""
        self.used = UsedPositions(self._sensors)
        for run in self._consensus.values():
            run.clear()

    def _lose(self, smoother: Smoother, name: str, gate: ReceiverGate, now_ns: int) -> None:
        is_faulty = bool(set(gate.reasons) - BENIGN)
        if is_faulty:
            for position in self.used.of(name, now_ns - self._quarantine_ns(name)):
                self.take_out(smoother, position, Outcome.QUARANTINED)
        gate.become(Trust.LOST, hold_s=self._config.regain_s if is_faulty else 0.0)
        power = f"; gate power {gate.power_m:.2f} m" if isfinite(gate.power_m) else ""
        self._log.report(EventKind.RECEIVER_LOST, now_ns, name, in_words(gate.reasons) + power)

    def _quarantine_ns(self, sensor: str) -> int:
        """Return for how long a used position can be taken out again."""
        return round(max(self._config.quarantine_s, 2.5 * self.gates[sensor].period_s) * 1e9)

    def _enter(self, smoother: Smoother, position: Position, inflation: float, known: Compared | None = None) -> bool:
        key = smoother.node(position.stamp_ns)
        if key is not None:
            sensor = self._sensors[position.sensor]
            found = known or self._compare(smoother, key, position)
            if found.slow is None:
                scale = self._scales[position.sensor]
                factor = sensor.factor(found.keys, position, inflation * scale.value / scale.above, found.state)
            else:
                factor = coloured_factor(sensor, position, found, found.slow, inflation, sensor.loss, new=smoother.new)
            smoother.enter(position, factor)
        return key is not None

    def _compare(self, smoother: Smoother, key: int, position: Position) -> Compared:
        """Compare a position with the state at its node."""
        colour, stamp_ns = position.colour, position.stamp_ns
        sensor = self._sensors[position.sensor]
        parameter_keys, state = with_parameters(smoother, sensor, smoother.state_at(stamp_ns), stamp_ns)
        keys, innovation = [key, *parameter_keys], sensor.innovation(position, state)
        if colour is None:
            return Compared(keys, state, innovation)
        slow = smoother.slow_error(position.sensor, colour, stamp_ns, position.p_W_P)
        return coloured(keys, state, innovation, colour, slow)


def _correlation_s(position: Position) -> float:
    """Return the correlation time of the errors of a position, or of what is white of them."""
    return position.correlation_s if position.colour is None else position.colour.white_correlation_s
