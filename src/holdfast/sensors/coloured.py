"""Measurements whose errors are coloured: white noise, and a slow error that is a state beside the machine's.

The slow error of one sensor is L u, with L a root of its share of what the sensor claims and u (m,) a Gauss-Markov
process of unit variance per axis: z = h(x) + L u + n, (61) in docs/math.md. Measurements that follow each other closely
then say as much as they do, of position as of heading: their common error is estimated, and not taken for news.
"""

from collections.abc import Sequence
from math import sqrt
from typing import Any, NamedTuple

import gtsam
import numpy as np

from holdfast.config.sensors import RobustLoss
from holdfast.messages import Array
from holdfast.sensors.noise import UNBOUNDED, Colour, noise_model
from holdfast.sensors.sensor import Comparing, Innovation, State, by_parameter, innovation_at

NAV_SIZE = 9
LINEAR_RAD = 0.02  # sigma of an attitude that is known well enough for a factor that is linear about the prediction


class SlowError(NamedTuple):
    """The slow error of one sensor in a graph, at the time of a measurement.

    Attributes:
        key: of the variable that holds it, and those of others.
        first: index of its first element there.
        value: (n,) estimate of the whole variable.
        covariance: (9 + m, 9 + m) joint one of the node and of the sensor's own elements.
    """

    key: int
    first: int
    value: Array
    covariance: Array


class Compared(NamedTuple):
    """A measurement beside the state that explains it.

    Attributes:
        keys: of the node and of the parameters.
        state: of node and parameters; its covariance (9 + m, 9 + m) is the joint one with the slow error.
        innovation: its `H` (m, 9 + m) has the slow error behind the node, and its `R` is that of the white part.
        slow: the slow error, None where the whole error is white.
    """

    keys: Sequence[int]
    state: State
    innovation: Innovation
    slow: SlowError | None = None

    @property
    def residual(self) -> Array:
        """(m,) By how much the measurement is beside the state, its slow error included."""
        if self.slow is None:
            return self.innovation.y
        root, first = self.innovation.H[:, NAV_SIZE:], self.slow.first
        residual: Array = self.innovation.y + root @ self.slow.value[first : first + len(self.innovation.y)]
        return residual


def coloured(keys: Sequence[int], state: State, innovation: Innovation, colour: Colour, slow: SlowError) -> Compared:
    """Return what is known of a measurement whose error has a colour; `R` of the innovation is what it claims."""
    size = len(innovation.y)
    root = root_of(innovation.R) * sqrt(colour.slow)
    y = innovation.y - root @ slow.value[slow.first : slow.first + size]
    H = np.concatenate([innovation.H, root], axis=1)
    own = Innovation(y, H, innovation.R * colour.white, innovation.J)
    return Compared(keys, state._replace(covariance=slow.covariance), own, slow)


def coloured_factor(  # noqa: PLR0917 (what a factor is made of)
    sensor: Comparing,
    measurement: Any,
    compared: Compared,
    slow: SlowError,
    inflation: float,
    loss: RobustLoss = UNBOUNDED,
    *,
    new: gtsam.Values | None = None,
) -> gtsam.NonlinearFactor:
    """Return the factor of a measurement on a node, on the sensor's parameters, and on its slow error.

    It is linear about the prediction where that is good: as precise, and far cheaper than one that is evaluated anew.

    Args:
        sensor: that compares the measurement with a state.
        measurement: what was measured.
        compared: with the current estimate.
        slow: the slow error in it.
        inflation: factor on the covariance of the white part.
        loss: of the sensor.
        new: the estimates of variables that the graph has not taken in yet; to put a `NavState` into other `Values`
            takes as long as all the rest of a factor.
    """
    keys, state, innovation, _ = compared
    root = np.zeros((len(innovation.y), len(slow.value)))
    root[:, slow.first : slow.first + len(innovation.y)] = innovation.H[:, NAV_SIZE:]
    every, noise = [*keys, slow.key], noise_model(innovation.R * inflation, loss)
    if loss.kind != "none" or state.covariance[:3, :3].trace() > LINEAR_RAD**2:
        return _nonlinear(sensor, every, measurement, state, root, noise)
    at = gtsam.Values() if new is None else gtsam.Values(new)
    sizes = [len(prior.mean) for prior in sensor.parameters]
    parameters = [value[0] for value in by_parameter(state.parameter[None, :], sizes)]
    for key, value in zip(every, [state.nav, *parameters, slow.value], strict=True):
        if not at.exists(key):
            at.insert(key, value)
    H = [innovation.H[:, :NAV_SIZE], *by_parameter(innovation.J, sizes), root]
    return gtsam.LinearContainerFactor(_linear(every, H, innovation.y, noise), at)


def _linear(keys: Sequence[int], H: Sequence[Array], y: Array, noise: gtsam.noiseModel.Base) -> gtsam.GaussianFactor:
    """Return the factor |sum of H x - y| of variables with their H (m, n); GTSAM's own takes no more than three."""

    def error(_: gtsam.CustomFactor, __: gtsam.Values, jacobians: Any) -> Array:
        for k, by_variable in enumerate(H):
            jacobians[k] = by_variable
        return -y

    return gtsam.CustomFactor(noise, list(keys), error).linearize(gtsam.Values())


def _nonlinear(  # noqa: PLR0917 (what a factor is made of)
    sensor: Comparing, keys: Sequence[int], measurement: Any, state: State, root: Array, noise: gtsam.noiseModel.Base
) -> gtsam.NonlinearFactor:
    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        found = innovation_at(sensor, keys[:-1], measurement, state, values, len(root))
        if jacobians is not None:
            sizes = [values.atVector(key).size for key in keys[1:-1]]
            for k, block in enumerate((found.H, *by_parameter(found.J, sizes), root)):
                jacobians[k] = block
        residual: Array = root @ values.atVector(keys[-1]) - found.y
        return residual

    return gtsam.CustomFactor(noise, list(keys), error)


def root_of(covariance: Array) -> Array:
    """Return a root (m, m) of a covariance (m, m): diagonal where that is."""
    if np.count_nonzero(covariance) == len(covariance):
        return np.diag(np.sqrt(covariance.diagonal()))
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
