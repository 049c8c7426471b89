"""Whether the estimate is wrong, and what begins in its place: what was measured judges it, not it what was measured.

Positions that agree among themselves against the estimate are right, sooner where an odometry or velocities say the
same; a bias that has jumped, a clock that is off and antennas that are elsewhere are found by what they explain.
"""

from collections.abc import Mapping

from holdfast.config.model import GateConfig
from holdfast.estimator.batch_clock import Offset
from holdfast.estimator.successor import Beginning, Successor
from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.graph.dual_graph import DualGraph
from holdfast.integrity.odometries import Odometries
from holdfast.integrity.positions import Contradiction, Positions
from holdfast.integrity.states import States
from holdfast.sensors.clock import GNSS_CLOCK
from holdfast.sensors.heading import MOUNT
from holdfast.sensors.sensor import Parameter, Role

MISTAKEN = "it is late, of another sign or in other axes, as the positions show"
TOLD_NS = 5_000_000_000  # what the graph knows of constants is looked at this often


class Judgement:
    """Asks all that guards the graphs, after each update, whether the estimate can go on.

    Args:
        config: of the gate.
        graph: that is judged.
        successor: what would begin anew.
        log: where events go.
        positions: of receivers and prisms.
        states: velocities among them.
        odometries: those of the machine.
        priors: what is known of constants of sensors before anything is measured, by name.
    """

    def __init__(
        self,
        config: GateConfig,
        graph: DualGraph,
        successor: Successor,
        log: EventLog,
        *,
        positions: Positions,
        states: States,
        odometries: Odometries,
        priors: Mapping[str, Parameter],
    ) -> None:
        self._gate, self._graph, self._successor, self._log = config, graph, successor, log
        self._positions, self._states, self._odometries = positions, states, odometries
        self._priors, self._told_ns = priors, graph.published.newest_ns

    def beginning(self, now_ns: int, *, was_vague: bool = False) -> Beginning | None:
        """Return a state to begin anew from, if what was measured contradicts the estimate; report why.

        `was_vague` says that the attitude was before the last optimisation: that may have led it astray.
        """
        is_turned = self._odometries.part_from_gyroscope(now_ns)
        has_witness = self._odometry_vouches(is_turned=is_turned)
        # else it is the positions that have begun to err
        is_alone = has_witness or is_turned or not self._odometries.has_agreed()
        contradiction = self._contradiction(has_witness=has_witness) if is_alone else None
        mistaken = self._graph.main.parameters.newly_mistaken()
        is_mounted_otherwise = any(self._priors[name].part == MOUNT for name in mistaken if name in self._priors)
        if self._odometries.newly_turned() or is_mounted_otherwise:
            self._successor.doubt()
        beginning = self._successor.settle_doubt()
        if beginning is None and contradiction is not None:
            beginning = self._successor.begin(self._graph.published.newest, contradiction.since_ns)
        if beginning is None and is_alone and ((is_astray := self._is_astray()) or is_turned):
            beginning = self._successor.after_jump(now_ns, has_witness=is_turned, is_astray=is_astray)
        if beginning is None:
            beginning = self._with_moved_antennas(now_ns)
        if beginning is None and was_vague:
            beginning = self._successor.turned(self._graph.published.newest)
        if beginning is not None:
            sensor = "" if contradiction is None else contradiction.sensor
            self._log.report(EventKind.BEGUN_ANEW, now_ns, sensor, beginning.reason)
        return beginning

    def tell_constants(self, now_ns: int) -> None:
        """Let what would begin anew know the clock of GNSS and the mounts of headings, while positions are expected."""
        if now_ns - self._told_ns < TOLD_NS or self._successor.is_in_doubt or self._positions.suspects():
            return
        self._told_ns, start = now_ns, self._successor.start
        off = {name: one for name, one in self._graph.main.constants(self._priors).items() if one.is_off}
        start.found.turn_headings({name: one.value for name, one in off.items()})
        if (clock := off.get(GNSS_CLOCK)) is not None:
            offset = Offset(float(clock.value[0]) - start.clock_ns * 1e-9, float(clock.sigmas[0]))
            if offset.is_off:
                start.found.know_clock_off(offset)

    def hold_mistaken(self, now_ns: int) -> None:
        """Keep velocities out that are late, of another sign or in other axes."""
        self._states.hold(self._successor.start.mistaken())
        for name in sorted(self._successor.newly_mistaken()):
            self._log.report(EventKind.SENSOR_LOST, now_ns, name, MISTAKEN)

    def _with_moved_antennas(self, now_ns: int) -> Beginning | None:
        """Return a state to begin from if antennas that are elsewhere explain what was measured better."""
        if self._positions.are_arms_proven:
            self._successor.start.settle_arms()
        is_suspected = not self._positions.suspects().keys() <= self._positions.disbelieved
        return self._successor.with_moved_antennas(now_ns, is_suspected=is_suspected)

    def _is_astray(self) -> bool:
        """Whether positions or velocities are not what the estimate expects, several in a row."""
        return self._positions.are_unexpected or bool(self._states.contradicting(Role.VELOCITY))

    def _odometry_vouches(self, *, is_turned: bool) -> bool:
        """Whether an odometry that is trusted moves as positions that contradict do: they are then believed sooner.

        What is not trusted is no help in beginning anew either.
        """
        start, departure = self._successor.start, self._positions.departure()
        for name in self._odometries.distrusted:
            start.forget_odometry(name)
        vouches = departure is not None and start.odometry_vouches(departure)
        since_ns = min(self._positions.suspects().values(), default=self._graph.published.newest_ns)
        has_odometry = self._odometries.has_held(since_ns) and not (vouches or is_turned)
        have_jumped = self._positions.have_jumped
        self._positions.be_patient(self._gate.patience_s(has_odometry=has_odometry, have_jumped=have_jumped))
        return vouches

    def _contradiction(self, *, has_witness: bool) -> Contradiction | None:
        """Return which positions contradict the estimate; a witness that says the same makes fewer of them enough."""
        found = self._positions.contradiction(has_witness=has_witness)
        witnesses = self._states.contradicting(Role.VELOCITY)
        if found is not None or not witnesses:
            return found
        early = self._positions.contradiction(has_witness=True)
        if early is None:
            return None
        nav = self._graph.published.newest.nav
        return early if self._successor.start.is_confirmed(witnesses, early.since_ns, nav) else None
