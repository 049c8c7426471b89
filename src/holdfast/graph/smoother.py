"""The fixed-lag smoother: nodes at exact measurement times, motion between them, one optimisation at a time.

The state of a node is a `NavState` (one 9-dimensional variable, so that its marginal keeps the correlation of attitude,
position and velocity); biases are constant over short epochs that a random walk joins.
"""

from collections.abc import Callable, Mapping
from copy import copy
from types import MappingProxyType

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.graph.biases import Biases
from holdfast.graph.chain import Chain, Motion
from holdfast.graph.nodes import FRAME, Link, to_grid
from holdfast.graph.parameters import REFRESHED_NS, Parameters
from holdfast.graph.prior import joint_prior
from holdfast.graph.relinearisation import thresholds
from holdfast.graph.slow_errors import SlowErrors, sizes_of
from holdfast.graph.solution import check_solution, check_step
from holdfast.graph.solver import Placed, Solver
from holdfast.graph.tail import BIAS_END, Tail, node_beside
from holdfast.graph.window import Window
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.printable import first_line
from holdfast.sensors.coloured import NAV_SIZE, SlowError
from holdfast.sensors.constants import Constant
from holdfast.sensors.imu import ImuBuffer, Turning
from holdfast.sensors.noise import FREE_VARIANCE, Colour
from holdfast.sensors.preintegration import ImuNoise, MotionModel
from holdfast.sensors.sensor import Joint, Measurement, Parameter, State
from holdfast.state import OptimisedState, is_finite

SETTLE_MARGIN_NS = 1_000_000_000  # a node is read this long before it leaves the window; updates are not further apart
FREE = FREE_VARIANCE**0.5  # sigma of what a factor says nothing about
NO_COVARIANCE = np.zeros((NAV_SIZE, NAV_SIZE))
FORGET_NS = 1_000_000_000  # measurements that left the window are dropped this often
MAX_VARIANCE = 1e6  # beyond it a covariance says no more, whatever its unit
VAGUE_RAD = 0.35  # sigma of an attitude that is predicted, beyond which a step of Gauss-Newton may lead astray
FAULT_INFLATION = 4.0  # of the covariance, when the graph is re-anchored after a failed optimisation


class OptimiserError(Exception):
    """An optimisation failed; the smoother has re-anchored itself at its last good state."""


class Smoother:
    """A sliding window of nodes over one IMU, begun at one state with its covariance as the prior.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        gravity: [m/s^2].
        state: where it begins.
        new_solver: makes an empty solver; without it a `Window`.
        known: tells the state at the time of a new node [ns], if it is known better than by prediction.
        carried: priors of constants of sensors, by name, as they were learnt before.
        found: the same, as they were found by what has found the state.
        arm: the shift of antennas that have told where it begins, if that is estimated.

    Attributes:
        parameters: what is known of constants of sensors.
    """

    def __init__(
        self,
        config: Config,
        buffer: ImuBuffer,
        gravity: float,
        state: OptimisedState,
        new_solver: Callable[[], Solver] | None = None,
        *,
        known: Callable[[int], gtsam.NavState | None] = lambda _: None,
        carried: Mapping[str, Parameter] = MappingProxyType({}),
        found: Mapping[str, Parameter] = MappingProxyType({}),
        arm: Parameter | None = None,
    ) -> None:
        imu = config.imu
        self._lag_ns = round(config.graph.lag_s * 1e9)
        self.imu = buffer
        self.imu_noise = ImuNoise(imu, config.graph.position_integration_sigma, gravity)
        model = MotionModel(config.motion_model, gravity)
        self._motion = Motion(buffer, self.imu_noise, model, config.graph.nodes == "imu", known)
        self._greatest_bias = np.repeat([imu.accelerometer_range, imu.gyroscope_range], 3)
        attitude_rad = config.graph.relinearize_threshold_rad
        self._new_solver = new_solver or (lambda: Window(thresholds(attitude_rad, self._slow_errors.size)))
        self.parameters = Parameters(max(REFRESHED_NS, self._lag_ns // 3), carried, found)
        self._biases = Biases(config, self.parameters, self.imu_noise)
        self._slow_sizes = sizes_of(config)
        self._frames_made, self._arm = 0, arm
        self._begin(state)

    def _begin(self, state: OptimisedState) -> None:
        """Begin a window; of what was before only the parameters of the sensors are known."""
        self._slow_errors = SlowErrors(self._slow_sizes)
        self._window = self._new_solver()
        self._measured: dict[int, tuple[Measurement, Placed]] = {}  # by the identity of the measurement
        self._chain = Chain(self._motion, self._biases, self._window, state)
        self._settled_ns, self._state = NEVER_NS, state
        self._tail = Tail(state.covariance)  # new nodes included
        keys = self._chain.key(self.newest_ns), self._biases.newest_key
        arm = None if self._arm is None else self.parameter(self._arm.shared, self._arm, state.stamp_ns)[:2]
        self.add(joint_prior(*keys, state, arm))

    def clone(self) -> "Smoother":
        """Return a smoother of its own with the same window, measurements included.

        It must follow `optimise`, so that nothing waits to be taken in. The estimate is the same to rounding.
        """
        other = copy(self)
        other._window, counterpart = self._window.copy()
        other.parameters = self.parameters.copy(other._window, counterpart)
        other._biases = self._biases.copy(other.parameters, counterpart, self._window)
        other._chain = self._chain.copy(other._window, counterpart, other._biases)
        held = ((key, one, placed) for key, (one, placed) in self._measured.items() if self._holds(placed))
        other._measured = {key: (one, counterpart(placed)) for key, one, placed in held}
        other._slow_errors = self._slow_errors.copy()
        return other

    @property
    def is_solved(self) -> bool:
        """Whether no variable waits for `optimise`, so that it can be cloned."""
        return not self._window.new.size()

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest node."""
        return self._chain.newest_ns

    @property
    def oldest_ns(self) -> int:
        """Measurements before this time come too late."""
        return self._chain.oldest_ns

    @property
    def newest(self) -> OptimisedState:
        """The newest node as of the last optimisation."""
        return self._state

    def __len__(self) -> int:
        return len(self._chain)

    def links(self) -> list[Link]:
        """Return the links between neighbouring nodes, in the order of time."""
        return self._chain.links()

    def has_node(self, stamp_ns: int) -> bool:
        """Whether there is a node at a time: not where a window was begun anew after it was made."""
        return to_grid(stamp_ns) in self._chain

    def node(self, stamp_ns: int) -> int | None:
        """Return the key of the node at a time, making it where there is none; None if the time left the window."""
        stamp = to_grid(stamp_ns)
        if stamp < self.oldest_ns:
            return None
        if stamp not in self._chain:
            if stamp < self.newest_ns:
                self._chain.split(stamp)
            else:
                for prediction in self._chain.extend(stamp):
                    self._tail = self._tail.moved(prediction)
        return self._chain.key(stamp)

    def turn_vague(self, heading: Callable[[int, gtsam.Rot3], float | None]) -> bool:
        """Begin the next `optimise` at a heading that is measured if the one that is predicted is vague; say whether.

        Gauss-Newton does not find back from a heading that a drop-out has left far off.

        Args:
            heading: by how much an attitude must be turned about the vertical at a time, to be as measured [rad].
        """
        if not self._chain.is_new(self.newest_ns) or self._tail.node[:3, :3].trace() < VAGUE_RAD**2:
            return False
        by_rad = heading(self.newest_ns, self._chain.nav(self.newest_ns).attitude())
        if by_rad is not None:
            self._chain.turn(gtsam.Rot3.Yaw(by_rad))
        return True

    def key(self, stamp_ns: int) -> int:
        """Return the key of the node at a time, which must exist."""
        return self._chain.key(to_grid(stamp_ns))

    def add(self, factor: gtsam.NonlinearFactor) -> Placed:
        """Add a factor on existing nodes; it takes effect with the next `optimise`."""
        return self._window.add(factor)

    def enter(self, measurement: Measurement, factor: gtsam.NonlinearFactor) -> None:
        """Add the factor of a measurement on existing nodes; it takes effect with the next `optimise`."""
        self._measured[id(measurement)] = measurement, self.add(factor)

    def retract(self, measurement: Measurement) -> None:
        """Take out the factor of a measurement, if the window holds it, with the next `optimise`."""
        found = self._measured.pop(id(measurement), None)
        if found is not None and self._holds(found[1]):
            self._window.retract(found[1])

    def _holds(self, placed: Placed) -> bool:
        """Whether a factor is still there: it leaves with the first of its variables."""
        return all(key in self._window for key in placed.factor.keys())  # noqa: SIM118 (no mapping)

    def parameter(
        self, name: str, prior: Parameter, stamp_ns: int, start: Array | None = None
    ) -> tuple[int, Array, Array]:
        """Return the key of a sensor's parameter for a factor at a time, its estimate (p,) and covariance (p, p).

        `start` (p,) is where a new one is linearised; without it at the mean of the prior.
        """
        known = self.parameters.use(self._window, name, prior, to_grid(stamp_ns), start)
        return known.key, known.value, known.covariance

    def constants(self, priors: Mapping[str, Parameter]) -> dict[str, Constant]:
        """Return what is known of the parameters of some names."""
        found = {name: self.parameters.constant(name, prior) for name, prior in priors.items()}
        return {name: one for name, one in found.items() if one is not None}

    def review_parameters(self, priors: Mapping[str, Parameter]) -> bool:
        """Read parameters after a batch has converged; return whether it must once more, as their belief changed."""
        return self.parameters.review(self._window, priors)

    def slow_error(self, name: str, colour: Colour, stamp_ns: int, at_W: Array | None = None) -> SlowError:
        """Return the slow error of a sensor at a time, whose node must exist, made a variable where there is none."""
        stamp, errors = to_grid(stamp_ns), self._slow_errors
        epoch, step = errors.use(self._window, name, colour, stamp, at_W)
        if step is not None:
            self._tail = self._tail.with_epoch(step)
        block = errors.block(name)
        joint: Array | None = None
        if stamp == self.newest_ns and epoch is errors.newest:
            joint, first = self._tail.covariance, BIAS_END
        elif not self._chain.is_new(stamp) and errors.is_solved(epoch):
            joint, first = self._window.covariance(self._chain.key(stamp), epoch.key), NAV_SIZE
        if joint is not None:
            covariance = node_beside(joint, first + block.start, first + block.stop)
        else:  # a late measurement: what both have in common is left out
            covariance = np.eye(NAV_SIZE + block.stop - block.start)
            covariance[:NAV_SIZE, :NAV_SIZE] = self.covariance(stamp)
        return SlowError(epoch.key, block.start, errors.value(self._window, epoch), covariance)

    @property
    def new(self) -> gtsam.Values:
        """The variables that are not optimised yet; not to be written."""
        return self._window.new

    def renew_slow_errors(self) -> None:
        """Let the slow errors from here on have nothing to do with those before."""
        self._slow_errors = self._slow_errors.without_past()
        self._tail = self._tail.without_slow_errors()

    def insert_frame(self, frame: gtsam.Pose3, stamp_ns: int) -> int:
        """Make a variable for the pose of a frame in W and return its key; what joins it to others is up to factors."""
        self._frames_made += 1
        key: int = gtsam.symbol(FRAME, self._frames_made)
        self._window.insert(key, gtsam.NavState(frame, np.zeros(3)), to_grid(stamp_ns))
        return key

    def has_frame(self, key: int) -> bool:
        """Whether a frame is still in the window."""
        return key in self._window

    def keep_frame(self, key: int, stamp_ns: int) -> None:
        """Keep a frame in the window as long as the time of a factor that uses it."""
        self._window.keep(key, to_grid(stamp_ns))

    def enter_zero_velocity(self, standing: Measurement, sigma_m_s: float) -> None:
        """Add a zero-velocity factor at a time, on a node that is made: a prior on `NavState` with free pose."""
        key = self.node(standing.stamp_ns)
        if key is not None:
            still = gtsam.NavState(self.nav(standing.stamp_ns).pose(), np.zeros(3))
            model = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([FREE, FREE, sigma_m_s], 3))
            self.enter(standing, gtsam.PriorFactorNavState(key, still, model))

    def bias(self, link: Link) -> tuple[gtsam.imuBias.ConstantBias, Array]:
        """Return the bias in a link, without errors in proportion to the turning, and its covariance (6, 6)."""
        return self._biases.without_error(self._window, link.bias_key)

    def seen_bias(self, turning: Turning) -> gtsam.imuBias.ConstantBias:
        """Return the newest bias together with the errors in proportion to a turning."""
        return self._biases.seen(self._state.bias, turning.rate)

    def turning_covariance(self, angle_rad: Array, time_s: float = 0.0) -> Array:
        """Return the covariance (3, 3) of what constant errors of the gyroscope make of a turning [rad^2].

        It is by angles (3,) [rad] about the axes of I, and lasts for a time, in which the bias counts.
        """
        bias_variance = float(np.trace(self._state.covariance[12:15, 12:15])) / 3.0
        return self._biases.error(angle_rad)[1] + bias_variance * time_s**2 * np.eye(3)

    def nav(self, stamp_ns: int) -> gtsam.NavState:
        """Return the current estimate of the node at a time, which must exist."""
        return self._chain.nav(to_grid(stamp_ns))

    def state_at(self, stamp_ns: int, joint: Joint | None = None) -> State:
        """Return what a measurement at a time is compared with; its node must exist. `joint` is the turn joint then."""
        return self._chain.state_at(to_grid(stamp_ns), joint, self.covariance(stamp_ns))

    def mean_at(self, stamp_ns: int, joint: Joint | None = None) -> State:
        """Return the same with zeros for the covariance, which takes longer than all else."""
        return self._chain.state_at(to_grid(stamp_ns), joint, NO_COVARIANCE)

    def angular_velocity(self, stamp_ns: int) -> Array:
        """Return the angular velocity (3,) of I at the node at a time, which must exist [rad/s]."""
        return self._chain.angular_velocity(to_grid(stamp_ns))

    def covariance(self, stamp_ns: int) -> Array:
        """Return the covariance (9, 9) of the node at a time, new factors left out.

        For a node that was just made between two others it is that of the one before.
        """
        stamp = to_grid(stamp_ns)
        if stamp == self.newest_ns:
            return self._tail.node
        while self._chain.is_new(stamp):
            if stamp == self.oldest_ns:
                return self._state.covariance[:9, :9]
            stamp = self._chain.before(stamp)
        return self._window.covariance(self._chain.key(stamp))

    def mark_silent(self, since_ns: int) -> None:
        """Put the motion model in place of IMU factors after a time: the samples under them were no measurements."""
        since_ns = to_grid(since_ns)
        if self.oldest_ns < since_ns < self.newest_ns:
            self.node(since_ns)
        self._chain.mark_silent(since_ns)

    def move(self, correction: gtsam.Pose3, position_sigma_m: float) -> None:
        """Start anew at the newest state, moved by a correction in W, its position in doubt; what waits is lost."""
        state = self._state
        nav = gtsam.NavState(correction * state.nav.pose(), correction.rotation().rotate(state.nav.velocity()))
        covariance = state.covariance.copy()
        covariance[3:6, 3:6] += np.eye(3) * min(position_sigma_m**2, MAX_VARIANCE)
        self._begin(OptimisedState(state.stamp_ns, nav, state.bias, covariance, state.angular_velocity))

    def lengthen(self, lag_ns: int) -> None:
        """Let the window become so long; it becomes shorter by steps, so that `settled` misses no node."""
        self._lag_ns = max(lag_ns, self._lag_ns - SETTLE_MARGIN_NS // 4)

    def settled(self) -> list[tuple[int, gtsam.NavState]]:
        """Return the nodes, with stamps, that have almost reached the end of the window since the last call."""
        horizon = self.newest_ns - self._lag_ns + SETTLE_MARGIN_NS
        stamps = [stamp for stamp in self._chain.until(horizon) if stamp > self._settled_ns]
        if stamps:
            self._settled_ns = stamps[-1]
        return [(stamp, nav) for stamp in stamps if is_finite(nav := self._chain.nav(stamp))]

    def measured(self, after_ns: int, until_ns: int) -> list[Measurement]:
        """Return the measurements in (after, until] whose factors the window holds."""
        return [one for one, _ in self._measured.values() if after_ns < one.stamp_ns <= until_ns]

    def last_before(self, stamp_ns: int) -> int | None:
        """Return the stamp of the last node at or before a time, or None if the window starts later."""
        return self._chain.at_or_before(stamp_ns)

    def optimise(self) -> OptimisedState:
        """Take in the new nodes and factors, optimise once, and return the newest node.

        Raises:
            OptimiserError: GTSAM failed; the window was started anew at the last good state, and the new factors lost.
        """
        horizon = self.newest_ns - self._lag_ns
        expected, covariance = self._chain.nav(self.newest_ns), self._tail.node
        try:
            self._slow_errors.keep(self._window, self.newest_ns)
            self._biases.prepare(self._window)
            self._window.solve(horizon)
            state, tail = self._read_newest()
            check_step(state.nav, expected, covariance)
        except Exception as error:  # of GTSAM, or of a sensor whose innovation it asked for
            self._reanchor()
            raise OptimiserError(first_line(error)) from error
        self._chain.mark_solved(state.bias, horizon)
        self.parameters.mark_solved()
        self._slow_errors.mark_solved()
        if self._measured and next(iter(self._measured.values()))[0].stamp_ns < self.oldest_ns - FORGET_NS:
            self._measured = {key: one for key, one in self._measured.items() if one[0].stamp_ns >= self.oldest_ns}
        self._state, self._tail = state, tail
        return state

    def _read_newest(self) -> tuple[OptimisedState, Tail]:
        """Return the newest state, and its covariance with that of the newest slow errors behind it."""
        stamp, key = self.newest_ns, self._chain.key(self.newest_ns)
        slow = self._slow_errors.newest
        slow_keys = [slow.key] if slow is not None and slow.key in self._window else []
        nav = self._window.nav(key)
        bias, covariance = self._biases.without_error(self._window, self._biases.newest_key, [key], slow_keys)
        tail = Tail(covariance)
        state = OptimisedState(stamp, nav, bias, tail.state, self._chain.angular_velocity(stamp, nav, bias))
        check_solution(state, tail, self._greatest_bias)
        return state, tail

    def _reanchor(self) -> None:
        """Start anew at the last good state; its covariance grows with every failure in a row, up to a bound."""
        state = self._state
        growth = min(FAULT_INFLATION, MAX_VARIANCE / float(np.diag(state.covariance).max()))
        covariance = state.covariance * max(1.0, growth)
        self._begin(OptimisedState(state.stamp_ns, state.nav, state.bias, covariance, state.angular_velocity))
