"""The biases of the IMU in one smoother, and the scale factors of its gyroscope.

A bias is constant over an epoch; a random walk joins the epochs. What the factors of an epoch see is the bias and the
mean error of the scale factors in it, b + [0; diag(w) s], so that they cost the window one variable and a factor of
the IMU nothing: (75) in docs/math.md.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.graph.nodes import BIAS
from holdfast.graph.parameters import Parameters
from holdfast.graph.solver import Placed, Solver
from holdfast.messages import Array
from holdfast.sensors.coloured import NAV_SIZE
from holdfast.sensors.constants import priors_of_imu
from holdfast.sensors.imu import NOT_TURNED, Turning
from holdfast.sensors.preintegration import ImuNoise

EPOCH_NS = 250_000_000
RATE_TOLERANCE = 1e-3  # of the mean angular velocity of an epoch [rad/s], below which a scale changes nothing
UNIT = gtsam.noiseModel.Unit.Create(6)


@dataclass(slots=True)
class Epoch:
    """A time in which a bias is constant.

    Attributes:
        number: counted from the start of the window, whose own bias is number 0.
        key: of its variable.
        scale_key: of the scale factors then; None where they are not estimated.
        turning: of the links that see it.
        walk: the factor that joins it to the epoch before.
        change: how much more angular velocity (3,) than the epoch before that factor knows [rad/s].
    """

    number: int
    key: int
    scale_key: int | None
    turning: Turning
    walk: Placed | None
    change: Array


class Biases:
    """The biases in one smoother.

    Args:
        config: of the estimator.
        parameters: of the smoother, the scale factors among them.
        noise: of the IMU, as has been learnt.
    """

    def __init__(self, config: Config, parameters: Parameters, noise: ImuNoise) -> None:
        imu = config.imu
        self._name = config.imu_name
        self._prior = priors_of_imu(config).get(self._name)
        self._walk = np.repeat([imu.accelerometer_random_walk, imu.gyroscope_random_walk], 3)
        self._parameters, self._noise = parameters, noise
        self._epochs: list[Epoch] = []
        self._begun_ns = 0
        self._stale: set[int] = set()  # numbers of epochs whose walk may know another turning than there was

    def copy(self, parameters: Parameters, counterpart: Callable[[Placed], Placed], solver: Solver) -> "Biases":
        """Return an equal one for a copy of the solver, in which each factor has a counterpart."""
        other = copy(self)
        other._parameters, other._stale = parameters, set(self._stale)
        self._forget(solver)
        other._epochs = [replace(one, walk=one.walk and counterpart(one.walk)) for one in self._epochs]
        return other

    @property
    def newest_key(self) -> int:
        """The key of the newest bias."""
        return self._epochs[-1].key

    def begin(self, solver: Solver, stamp_ns: int, bias: gtsam.imuBias.ConstantBias) -> None:
        """Begin anew: insert the bias of the start; a factor on it must follow."""
        key: int = gtsam.symbol(BIAS, 0)
        self._begun_ns = stamp_ns
        self._stale.clear()
        solver.insert(key, bias, stamp_ns)
        self._epochs = [Epoch(0, key, None, NOT_TURNED, None, np.zeros(3))]

    def use(self, solver: Solver, stamp_ns: int, turning: Turning, bias: gtsam.imuBias.ConstantBias) -> int:
        """Return the key of the bias that a link sees, by when it begins and turns; `bias` is the newest estimate."""
        number, newest = 1 + (stamp_ns - self._begun_ns) // EPOCH_NS, self._epochs[-1]
        if number <= newest.number:
            epoch = next((one for one in reversed(self._epochs) if one.number <= number), self._epochs[0])
            self._turn(epoch, turning)
            return epoch.key
        scale = None if self._prior is None else self._parameters.use(solver, self._name, self._prior, stamp_ns)
        key: int = gtsam.symbol(BIAS, number)
        solver.insert(key, self.seen(bias, turning.rate), stamp_ns)
        epoch = Epoch(number, key, None if scale is None else scale.key, turning, None, np.zeros(3))
        self._join(solver, newest, epoch)
        self._epochs.append(epoch)
        self._stale.add(newest.number)
        return key

    def release(self, key: int, turning: Turning) -> None:
        """Note that a link which saw a bias is no more."""
        epoch = self._epoch(key)
        if epoch is not None:
            self._turn(epoch, -turning)

    def keep(self, solver: Solver, key: int, stamp_ns: int) -> None:
        """Keep a bias, and the scale factors, for as long as the time of a factor that sees it."""
        solver.keep(key, stamp_ns)
        scale_key = self._epochs[-1].scale_key
        if scale_key is not None and scale_key in solver:
            solver.keep(scale_key, stamp_ns)

    def seen(self, bias: gtsam.imuBias.ConstantBias, rate: Array) -> gtsam.imuBias.ConstantBias:
        """Return what is seen of a bias at a mean angular velocity (3,) [rad/s]."""
        return gtsam.imuBias.ConstantBias(bias.accelerometer(), bias.gyroscope() + self.error(rate)[0])

    def error(self, rate: Array) -> tuple[Array, Array]:
        """Return by how much the scale factors are wrong (3,) at a rate (3,) [rad/s], with its covariance (3, 3).

        The same holds of the angle by which the gyroscope has turned [rad].
        """
        if self._prior is None:
            return np.zeros(3), np.zeros((3, 3))
        scale, covariance = self._parameters.belief(self._name, self._prior)
        return rate * scale, rate[:, None] * covariance * rate

    def prepare(self, solver: Solver) -> None:
        """Tell the walks how much the machine has turned, before the solver solves."""
        if not self._stale:
            return
        self._forget(solver)
        newest = self._epochs[-1].number
        for before, epoch in zip(self._epochs, self._epochs[1:], strict=False):
            is_stale = before.number in self._stale or (epoch.number in self._stale and epoch.number < newest)
            change = epoch.turning.rate - before.turning.rate
            if is_stale and epoch.walk is not None and np.abs(change - epoch.change).max() > RATE_TOLERANCE:
                solver.retract(epoch.walk)
                self._join(solver, before, epoch)
        self._stale.clear()

    def without_error(
        self, solver: Solver, key: int, navs: Sequence[int] = (), others: Sequence[int] = ()
    ) -> tuple[gtsam.imuBias.ConstantBias, Array]:
        """Return a bias without scale factors, and its joint covariance behind states and before other variables."""
        epoch, seen = self._epoch(key), solver.bias(key)
        if epoch is None or epoch.scale_key is None or epoch.scale_key not in solver:
            return seen, solver.covariance(*navs, key, *others)
        scale_key, rate = epoch.scale_key, epoch.turning.rate
        joint = solver.covariance(*navs, key, *others, scale_key)
        gyroscope, first = NAV_SIZE * len(navs) + 3, len(joint) - 3
        J = np.eye(first, len(joint))
        J[gyroscope : gyroscope + 3, first:] = -np.diag(rate)
        bias = gtsam.imuBias.ConstantBias(seen.accelerometer(), seen.gyroscope() - rate * solver.vector(scale_key))
        return bias, J @ joint @ J.T

    def _epoch(self, key: int) -> Epoch | None:
        return next((one for one in reversed(self._epochs) if one.key == key), None)

    def _turn(self, epoch: Epoch, turning: Turning) -> None:
        epoch.turning += turning
        self._stale.add(epoch.number)

    def _forget(self, solver: Solver) -> None:
        """Forget the epochs that have left the window, in the order in which they came."""
        while len(self._epochs) > 1 and self._epochs[0].key not in solver:
            del self._epochs[0]
            self._epochs[0].walk = None

    def _join(self, solver: Solver, before: Epoch, epoch: Epoch) -> None:
        """Let an epoch walk on from the one before."""
        sigmas = self._noise.walk_scale * self._walk * np.sqrt((epoch.number - before.number) * EPOCH_NS * 1e-9)
        zero = gtsam.imuBias.ConstantBias()
        epoch.change = epoch.turning.rate - before.turning.rate
        if epoch.scale_key is None:
            walk = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
            epoch.walk = solver.add(gtsam.BetweenFactorConstantBias(before.key, epoch.key, zero, walk))
            return
        weight, by_scale = np.diag(1.0 / sigmas), np.zeros((6, 3))
        by_scale[3:] = np.diag(-epoch.change / sigmas[3:])
        linear = gtsam.JacobianFactor(
            before.key, -weight, epoch.key, weight, epoch.scale_key, by_scale, np.zeros(6), UNIT
        )
        at = gtsam.Values()
        at.insert(before.key, zero)
        at.insert(epoch.key, zero)
        at.insert(epoch.scale_key, np.zeros(3))
        epoch.walk = solver.add(gtsam.LinearContainerFactor(linear, at))
