"""Fixes on their way into the dual graph: tested, weighed, taken out again, and switched over; headings with them."""

from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, sqrt

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.estimator.gate import HOLD_BACK, AntennaGate, Prediction, Trust, Waiting, predict
from holdfast.estimator.heading_fusion import HeadingFusion
from holdfast.estimator.journal import Journal
from holdfast.estimator.witness import LidarWitness
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.nodes import Placed
from holdfast.graph.smoother import OptimiserError, Smoother
from holdfast.messages import Array
from holdfast.sensors.gnss import AntennaPosition, GnssModel
from holdfast.sensors.heading import AxisYaw, HeadingModel
from holdfast.sensors.lidar import LidarModel
from holdfast.sensors.noise import correlation_inflation, shared_inflation
from holdfast.state import EventKind, Outcome

NO_DOUBT = np.zeros((9, 9))
SIMULTANEOUS_NS = 1_000_000  # in which even a fast machine moves by less than a fix is wrong
BASELINE_SIGMA = 4.0
BASELINE_SLACK_M = 0.02  # calibration of the antennas' places
WALK_FACTOR = 2.0  # fixes that walked must hold still for longer: at first they still look right
REVIEW_NS = 250_000_000  # used fixes are reviewed this often
BENIGN = {Outcome.LOW_STATUS, Outcome.LARGE_COVARIANCE, Outcome.NO_COVARIANCE, Outcome.NOT_FINITE}


@dataclass(slots=True, eq=False)
class Used:
    """A fix in the window of the main graph, with its factor."""

    fix: AntennaPosition
    placed: Placed


class GnssFusion:
    """The antennas of one machine; `graph` is given when the estimator starts."""

    def __init__(
        self,
        config: Config,
        antennas: dict[str, GnssModel],
        heading: HeadingModel | None,
        lidar: LidarModel | None,
        journal: Journal,
    ) -> None:
        self._gate = config.gate
        self._antennas = antennas
        self._configs = config.sensors.antennas()
        self._lidar = lidar
        self._tell, self._count = journal.tell, journal.count
        self._headings = None if heading is None else HeadingFusion(heading, journal)
        self._baseline_m = self._expected_baseline_m()
        self.restart()

    def restart(self) -> None:
        """Forget everything: the estimator starts, or starts over."""
        self.gates = {name: AntennaGate(self._gate, gnss) for name, gnss in self._configs.items()}
        self._used: deque[Used] = deque()
        self._last_fix: dict[str, tuple[AntennaPosition, float]] = {}  # with its NIS
        self._reviewed_ns = 0
        if self._headings is not None:
            self._headings.restart()
        self._witness = None if self._lidar is None or not self._gate.witness else LidarWitness(self._lidar)

    @property
    def is_trusted(self) -> bool:
        """Whether at least one antenna is trusted."""
        return any(gate.trust is Trust.TRUSTED for gate in self.gates.values())

    @property
    def has_lost(self) -> bool:
        """Whether at least one antenna is not trusted."""
        return bool(self.lost())

    def lost(self) -> list[str]:
        """Return the antennas that are not trusted."""
        return [name for name, gate in self.gates.items() if gate.trust is Trust.LOST]

    def distrust(self, names: Iterable[str]) -> None:
        """Begin with antennas that are not trusted."""
        for name in names:
            self.gates[name].become(Trust.LOST, hold_s=self._gate.regain_s)

    def refuse(self, sensor: str, outcome: Outcome) -> None:
        """Note a fix that the receiver itself calls bad."""
        if outcome in BENIGN:
            self.gates[sensor].refuse(outcome)

    def forget_window(self) -> None:
        """The graph lost its window, and with it every factor."""
        self._used.clear()
        if self._headings is not None:
            self._headings.forget()
        self.forget_track()

    def forget_track(self) -> None:
        """The lidar odometry has jumped, or the estimate has."""
        if self._witness is not None:
            self._witness.forget()

    def add(self, graph: DualGraph, fix: AntennaPosition, now_ns: int) -> Outcome:
        """Judge a fix at its node, and add its factor to the main graph if it may enter."""
        smoother = graph.published
        if smoother.node(fix.stamp_ns) is None:
            return Outcome.LATE
        model, gate = self._antennas[fix.sensor], self.gates[fix.sensor]
        covariance = smoother.covariance(fix.stamp_ns)
        prediction = predict(smoother.nav(fix.stamp_ns), covariance, model.p_I_G, fix)
        agrees = self._baseline_agrees(graph, fix, prediction)
        self._last_fix[fix.sensor] = fix, prediction.nis
        outcome = gate.judge(fix, prediction, now_ns=now_ns, baseline_agrees=agrees)
        if outcome is Outcome.USED:
            self._enter(graph.main, fix, gate.inflation(prediction))
        elif outcome is not Outcome.QUARANTINED:
            self._tell(EventKind.REJECTED, fix.stamp_ns, fix.sensor, outcome)
        return outcome

    def add_heading(self, graph: DualGraph, heading: AxisYaw) -> Outcome:
        """Judge a heading at its node, and add its factor to the main graph if it may enter."""
        assert self._headings is not None
        return self._headings.add(graph, heading)

    def review(self, graph: DualGraph, now_ns: int) -> bool:
        """After an optimisation: take out what later fixes contradict, lose and regain antennas.

        Returns:
            Whether GNSS was regained, so that the published graph is another one.
        """
        oldest_ns = graph.main.oldest_ns
        if any(used.fix.stamp_ns < oldest_ns for used in self._used):  # in the order of arrival, not of stamps
            self._used = deque(used for used in self._used if used.fix.stamp_ns >= oldest_ns)
        if self._gate.innovation and self._used and self._used[-1].fix.stamp_ns - self._reviewed_ns >= REVIEW_NS:
            self._reviewed_ns = self._used[-1].fix.stamp_ns
            self._retract_worst(graph.main)
        if self.is_trusted:
            self._hear_witness(graph, now_ns)
        for name, gate in self.gates.items():
            if gate.loses(now_ns):
                self._lose(graph, name, gate, now_ns)
        if self._antennas and not self.is_trusted and not graph.is_lost:
            self._tell(EventKind.GNSS_LOST, now_ns, "", "no antenna is trusted")
            graph.lose()
        regained = [name for name, gate in self.gates.items() if gate.regains()]
        if regained and self._regain(graph, regained, now_ns):
            return True
        return any(self._believe(graph, name, gate, now_ns) for name, gate in self.gates.items())

    # --- entering ------------------------------------------------------------------------------------------------

    def _enter(self, smoother: Smoother, fix: AntennaPosition, inflation: float) -> None:
        correlation_s = self._antennas[fix.sensor].correlation_s(fix)
        self._place(smoother, fix, inflation * correlation_inflation(correlation_s, self._since_last_s(fix)))

    def _enter_held(self, smoother: Smoother, held: list[Waiting]) -> None:
        """Enter fixes that waited; those of one antenna weigh the same, or the first would say more than all others."""
        for name, model in self._antennas.items():
            fixes = [one.fix for one in held if one.fix.sensor == name]
            if fixes:
                gaps_s = [(b.stamp_ns - a.stamp_ns) * 1e-9 for a, b in pairwise(fixes)]
                correlation_s = max(model.correlation_s(fix) for fix in fixes)
                inflation = shared_inflation(correlation_s, [self._since_last_s(fixes[0]), *gaps_s])
                for fix in fixes:
                    self._place(smoother, fix, inflation)

    def _since_last_s(self, fix: AntennaPosition) -> float:
        """Return the time since a used fix of the same antenna, infinite if the window has none."""
        before = next((used.fix.stamp_ns for used in reversed(self._used) if used.fix.sensor == fix.sensor), None)
        return inf if before is None else abs(fix.stamp_ns - before) * 1e-9

    def _place(self, smoother: Smoother, fix: AntennaPosition, inflation: float) -> None:
        key = smoother.node(fix.stamp_ns)
        if key is not None:
            weighed = replace(fix, covariance=fix.covariance * inflation)
            self._used.append(Used(fix, smoother.add(self._antennas[fix.sensor].factor(key, weighed))))

    def _expected_baseline_m(self) -> float | None:
        if len(self._antennas) != 2:
            return None
        left, right = self._antennas.values()
        return float(np.linalg.norm(right.p_I_G - left.p_I_G))

    def _baseline_agrees(self, graph: DualGraph, fix: AntennaPosition, prediction: Prediction) -> bool:
        """Whether the antennas are as far apart as they are mounted; if not, the estimate says which one is bad."""
        other = next((last for name, last in self._last_fix.items() if name != fix.sensor), None)
        if self._baseline_m is None or other is None or abs(other[0].stamp_ns - fix.stamp_ns) > SIMULTANEOUS_NS:
            return True
        between: Array = other[0].p_W_G - fix.p_W_G
        distance = float(np.linalg.norm(between))
        axis = between / max(distance, 1e-9)
        sigma = sqrt(float(axis @ (fix.covariance + other[0].covariance) @ axis))
        if not self._gate.baseline or abs(distance - self._baseline_m) <= BASELINE_SIGMA * sigma + BASELINE_SLACK_M:
            return True
        if prediction.nis >= other[1]:
            return False
        self._expel(graph.main, other[0])
        return True

    def _expel(self, smoother: Smoother, fix: AntennaPosition) -> None:
        """Take out one fix that was used, and hold it against its antenna."""
        self.gates[fix.sensor].refuse(Outcome.BASELINE)
        for used in [used for used in self._used if used.fix is fix]:
            self._take_out(smoother, used, Outcome.BASELINE)

    def _take_out(self, smoother: Smoother, used: Used, outcome: Outcome) -> None:
        self._used.remove(used)
        smoother.retract(used.placed)
        self._count(used.fix.sensor, Outcome.USED, -1)
        self._count(used.fix.sensor, outcome, 1)
        self._tell(EventKind.REJECTED, used.fix.stamp_ns, used.fix.sensor, outcome)

    def _retract_worst(self, smoother: Smoother) -> None:
        """Take out the fix that later ones contradict most, if its residual is beyond the gate: (21) in docs/math.md.

        A fix that looked plausible when it came may stand alone once its successors are in.
        """
        worst, worst_nis = None, 0.0
        newest_ns = self._used[-1].fix.stamp_ns
        for used in list(self._used)[:-1]:  # the newest has no successor yet, and may be what pulls at the others
            if newest_ns - used.fix.stamp_ns > self._horizon_ns(used.fix.sensor):
                continue
            arm = self._antennas[used.fix.sensor].p_I_G
            nis = predict(smoother.nav(used.fix.stamp_ns), NO_DOUBT, arm, used.fix).nis
            if nis > worst_nis:
                worst, worst_nis = used, nis
        if worst is not None and worst_nis > self.gates[worst.fix.sensor].limit:
            self._take_out(smoother, worst, Outcome.CONTRADICTED)

    def _horizon_ns(self, sensor: str) -> int:
        """Return how long a used fix stays in quarantine."""
        return round(max(self._gate.quarantine_s, 2.5 * self.gates[sensor].period_s) * 1e9)

    def _hear_witness(self, graph: DualGraph, now_ns: int) -> None:
        """Compare where the lidar odometry sees the machine with where GNSS has led the estimate."""
        scan = graph.newest_scan
        if self._witness is None or scan is None or scan.stamp_ns < graph.main.oldest_ns:
            return
        if not self._witness.wants(scan):
            return
        pose, covariance = graph.main.nav(scan.stamp_ns).pose(), graph.main.covariance(scan.stamp_ns)
        found = self._witness.observe(scan, pose, covariance)
        if found is None:
            return
        if found.is_slip:
            self._witness.forget()
            self._tell(EventKind.LIDAR_SLIP, now_ns, "lidar", f"{found.distance_m:.2f} m beside GNSS")
            graph.forget_scans(graph.main)
            return
        reason = f"{found.distance_m:.2f} m beside the lidar's track since {(now_ns - found.since_ns) * 1e-9:.1f} s"
        for used in list(self._used):
            self._take_out(graph.main, used, Outcome.WALKING)
        for name, gate in self.gates.items():
            if gate.trust is Trust.TRUSTED:
                gate.become(Trust.LOST, hold_s=WALK_FACTOR * self._gate.regain_s)
                self._tell(EventKind.ANTENNA_LOST, now_ns, name, reason)
        self._witness.forget_after(found.since_ns)
        with suppress(OptimiserError):
            graph.main.optimise()  # for the velocity that the lidar and the IMU see, without that of the walk
            pose = graph.main.nav(scan.stamp_ns).pose()
        graph.move(found.T_W_I0 * scan.T_I0_I * pose.inverse(), found.sigma_m)

    # --- switching -----------------------------------------------------------------------------------------------

    def _lose(self, graph: DualGraph, name: str, gate: AntennaGate, now_ns: int) -> None:
        reasons = ", ".join(f"{count} {outcome}" for outcome, count in gate.reasons.items()) or "silent"
        has_lied = bool(set(gate.reasons) - BENIGN)
        if has_lied:
            since_ns = now_ns - self._horizon_ns(name)
            doubtful = [used for used in self._used if used.fix.sensor == name and used.fix.stamp_ns >= since_ns]
            for used in doubtful:
                self._take_out(graph.main, used, Outcome.QUARANTINED)
        gate.become(Trust.LOST, hold_s=self._gate.regain_s if has_lied else 0.0)
        self._tell(EventKind.ANTENNA_LOST, now_ns, name, f"{reasons}; gate power {gate.power_m:.2f} m")

    def _regain(self, graph: DualGraph, names: list[str], now_ns: int) -> bool:
        """Let the quarantined fixes of antennas into the main graph; on trial if it was without GNSS."""
        held = sorted((one for name in names for one in self.gates[name].quarantine), key=lambda one: one.fix.stamp_ns)
        was_lost = graph.is_lost
        if was_lost:
            kept, self._used = self._used, deque()
            counterpart = graph.regain(lambda smoother: self._accepts(smoother, held))
            if counterpart is None:
                self._used = kept
                self._tell(EventKind.RECOVERY_REFUSED, now_ns, ", ".join(names), f"{len(held)} fixes do not agree")
                for name in names:
                    self.gates[name].become(Trust.LOST, hold_s=self._gate.regain_s)
                return False
            self._used = deque([Used(used.fix, counterpart(used.placed)) for used in kept] + list(self._used))
            self._tell(EventKind.GNSS_REGAINED, now_ns, "", f"{len(held)} fixes agree")
        else:
            self._enter_held(graph.main, held)
        for name in names:
            entered = self.gates[name].become(Trust.TRUSTED)
            self._count(name, Outcome.QUARANTINED, -len(entered))
            self._count(name, Outcome.USED, len(entered))
            self._tell(EventKind.ANTENNA_REGAINED, now_ns, name, f"{len(entered)} good fixes in a row")
        return was_lost

    def _accepts(self, smoother: Smoother, held: list[Waiting]) -> bool:
        """Add fixes to a smoother on trial, and say whether it agrees with them afterwards."""
        self._enter_held(smoother, held)
        try:
            smoother.optimise()
            if self._gate.innovation and not self._agrees(smoother):
                return False
            if self._headings is not None and self._headings.admit(smoother, held[0].fix.stamp_ns):
                smoother.optimise()
        except OptimiserError:
            return False
        return True

    def _agrees(self, smoother: Smoother) -> bool:
        """Whether the median of the used fixes lies where the smoothed states say."""
        residuals = [
            predict(smoother.nav(used.fix.stamp_ns), NO_DOUBT, self._antennas[used.fix.sensor].p_I_G, used.fix).nis
            for used in self._used
        ]
        return bool(residuals) and float(np.median(residuals)) <= HOLD_BACK * 4.0

    def _believe(self, graph: DualGraph, name: str, gate: AntennaGate, now_ns: int) -> bool:
        """Give in to fixes that contradict the estimate but have agreed with each other for long."""
        if gate.trust is Trust.TRUSTED or not gate.believes(self._gate.believe_after_s if self._lidar else 1.0):
            return False
        distance = gate.distance_m()
        self._tell(EventKind.ESTIMATE_SUSPECT, now_ns, name, f"{distance:.2f} m from the fixes")
        graph.move(gtsam.Pose3(), distance)
        self.forget_window()
        if self._lidar is not None:
            self._lidar.trust_less()
        gate.become(Trust.TRUSTED)
        return True
