"""When GNSS is lost and regained, and what the graphs do then: fallback, trial, adoption, and giving in."""

from contextlib import suppress

import gtsam

from holdfast.config.model import GateConfig
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.graph.dual_graph import DualGraph
from holdfast.graph.smoother import OptimiserError, Smoother
from holdfast.integrity.headings import Headings
from holdfast.integrity.odometries import Odometries, Walk
from holdfast.integrity.positions import Positions
from holdfast.integrity.receiver import HOLD_BACK, Held, Trust

WALK_FACTOR = 2.0  # fixes that walked must be consistent for longer: at first they still look right
GATE_NIS = 4.0


class Recovery:
    """Switches between the graphs by the trust in the receivers of positions.

    Args:
        config: of the gates.
        positions: the receivers.
        headings: that depend on them.
        odometries: that monitor them.
        log: where counts and events go.
    """

    def __init__(
        self, config: GateConfig, positions: Positions, headings: Headings, odometries: Odometries, log: EventLog
    ) -> None:
        self._config = config
        self._positions, self._headings, self._odometries = positions, headings, odometries
        self._log = log

    def review(self, graph: DualGraph, now_ns: int) -> bool:
        """After an optimisation: take out what later positions contradict, lose and regain receivers, switch graphs.

        Returns:
            Whether GNSS was regained, so that the published graph is another one.
        """
        if not graph.main.is_solved:
            return False  # it has just failed and begins anew at its last state: there is nothing to be tried in
        positions = self._positions
        positions.review(graph.main)
        if positions.lead:
            walk = self._odometries.find_walk(graph, now_ns)
            if walk is not None:
                self._undo(graph, walk, now_ns)
        positions.lose_due(graph.main, now_ns)
        if positions.gates and not positions.is_trusted and not graph.is_lost:
            self._log.report(EventKind.GNSS_LOST, now_ns, "", "no receiver is trusted")
            graph.lose()
        regained = positions.regained()
        if regained and self._regain(graph, regained, now_ns):
            return True
        return any(self._believe(graph, name, now_ns) for name in positions.gates)

    def _undo(self, graph: DualGraph, walk: Walk, now_ns: int) -> None:
        """Take a walk of the fixes out of the estimate: go back to where the odometry sees the machine."""
        pose, found = walk.pose, walk.found
        since_s = (now_ns - found.since_ns) * 1e-9
        reason = f"{found.distance_m:.2f} m beside the track of {walk.odometry} since {since_s:.1f} s"
        self._positions.take_out_all(graph.main, Outcome.WALKING)
        for name, gate in self._positions.gates.items():
            if gate.trust is Trust.TRUSTED:
                gate.become(Trust.LOST, hold_s=WALK_FACTOR * self._config.regain_s)
                self._log.report(EventKind.RECEIVER_LOST, now_ns, name, reason)
        self._odometries.forget_after(found.since_ns)
        estimate = self._odometries.estimated(graph, pose)
        with suppress(OptimiserError):
            graph.main.optimise()  # for the velocity that odometry and IMU see, without that of the walk
            estimate = self._odometries.estimated(graph, pose)
        graph.move(found.T_W_I * estimate.inverse(), found.sigma_m)

    def _regain(self, graph: DualGraph, names: list[str], now_ns: int) -> bool:
        """Let the quarantined positions of receivers into the main graph; on trial if it was without GNSS."""
        positions = self._positions
        held = sorted(
            (one for name in names for one in positions.gates[name].quarantine), key=lambda one: one.position.stamp_ns
        )
        was_lost = graph.is_lost
        if was_lost:
            trial = graph.trial()
            if not self._accepts(trial, held, now_ns):
                reason = f"{len(held)} positions do not agree"
                self._log.report(EventKind.RECOVERY_REFUSED, now_ns, ", ".join(names), reason)
                positions.distrust(names)
                return False
            graph.adopt(trial)
            self._log.report(EventKind.GNSS_REGAINED, now_ns, "", f"{len(held)} positions agree")
        else:
            positions.used.extend(positions.enter_held(graph.main, held, is_trial=False))
        for name in names:
            entered = positions.gates[name].become(Trust.TRUSTED)
            self._log.count(name, Outcome.QUARANTINED, -len(entered))
            self._log.count(name, Outcome.USED, len(entered))
            for one in entered:
                self._log.record(one.position.stamp_ns, name, Outcome.USED)
            self._log.report(EventKind.RECEIVER_REGAINED, now_ns, name, f"{len(entered)} good positions in a row")
        return was_lost

    def _accepts(self, trial: Smoother, held: list[Held], now_ns: int) -> bool:
        """Add positions to a smoother on trial, and say whether it agrees with them afterwards."""
        positions = self._positions
        trial.renew_slow_errors()  # ambiguities are resolved anew, and multipath has changed
        entered = positions.enter_held(trial, held, is_trial=True)
        try:
            trial.optimise()
            if self._config.innovation and positions.used.median_nis(entered, trial) > HOLD_BACK * GATE_NIS:
                return False
            if self._headings.admit(trial, held[0].position.stamp_ns, now_ns):
                trial.optimise()
        except OptimiserError:
            return False
        positions.used.extend(entered)
        return True

    def _believe(self, graph: DualGraph, name: str, now_ns: int) -> bool:
        """Give in to positions that contradict the estimate but have agreed with each other for long.

        Not where another receiver is trusted: then it is the one that is alone.
        """
        positions = self._positions
        gate = positions.gates[name]
        is_disbelieved = positions.lead or name in positions.disbelieved
        if is_disbelieved or not gate.contradicts_for(positions.believe_after_s):
            return False
        distance = gate.distance_m()
        self._log.report(EventKind.ESTIMATE_SUSPECT, now_ns, name, f"{distance:.2f} m from the positions")
        graph.move(gtsam.Pose3(), distance)
        self.forget_window()
        self._odometries.trust_less()
        gate.become(Trust.TRUSTED)
        return True

    def forget_window(self) -> None:
        """The graph lost its window, and with it every factor; or the estimate was moved."""
        self._positions.forget_window()
        self._headings.forget_window()
        self._odometries.forget_frames()
