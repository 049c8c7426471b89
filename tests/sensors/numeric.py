"""Jacobians of factors and of innovations by central differences, against those that they claim."""

import gtsam
import numpy as np
from motion import DATUM

from holdfast.geometry.world import World
from holdfast.sensors.sensor import Joint, State

STEP = 1e-5  # error of the difference: STEP^2 times the third derivative, plus round-off / STEP
X, C = gtsam.symbol("x", 0), gtsam.symbol("B", 0)
PLACED = World()
PLACED.place(DATUM)


def assert_jacobians(factor, values, tolerance=1e-6):
    """Compare `factor.linearize` with differences of its whitened residual, for every key."""
    A = _whitened(factor, values)
    column = 0
    for key in factor.keys():  # noqa: SIM118 - no mapping
        dim = 6 if gtsam.Symbol(key).chr() == ord("b") else 9
        for axis in range(dim):
            step = np.zeros(dim)
            step[axis] = STEP
            numeric = (residual(factor, moved(values, key, step)) - residual(factor, moved(values, key, -step))) / (
                2.0 * STEP
            )
            np.testing.assert_allclose(A[:, column], numeric, atol=tolerance * max(1.0, abs(A).max()))
            column += 1
    assert column == A.shape[1]


def moved(values, key, step):
    other = gtsam.Values(values)
    if len(step) == 6:
        other.update(key, values.atConstantBias(key).retract(step))
    else:
        other.update(key, values.atNavState(key).retract(step))
    return other


def residual(factor, values):
    """Whitened residual: what `linearize` keeps as -b."""
    return -factor.linearize(values).jacobian()[1]


def _whitened(factor, values):
    return factor.linearize(values).jacobian()[0]


# --- innovations ------------------------------------------------------------------------------------------------------


def random_state(seed, parameter_sigmas=(), tilt_rad=1.0):
    """A state in any attitude, the turn joint and the sensor's parameter included."""
    rng = np.random.default_rng(seed)
    attitude = gtsam.Rot3.RzRyRx(*rng.uniform(-tilt_rad, tilt_rad, 2), rng.uniform(-3.1, 3.1))
    nav = gtsam.NavState(attitude, rng.normal(0.0, 20.0, 3), rng.normal(0.0, 3.0, 3))
    root = rng.normal(0.0, 0.01, (9, 9))
    sigmas = np.array(parameter_sigmas)
    return State(
        nav,
        root @ root.T + 1e-6 * np.eye(9),
        rng.normal(0.0, 0.5, 3),
        Joint(rng.uniform(-3.0, 3.0), rng.normal(0.0, 0.5)),
        rng.normal(0.0, 1.0, len(sigmas)) * sigmas,
        np.diag(sigmas**2),
    )


def assert_derivatives(sensor, measurement, state, tolerance=1e-6):
    """Compare H and J of an innovation y = z - h(x, c) with differences of -y."""

    def y(change, index, by):
        step = np.zeros(9 if change == "nav" else len(state.parameter))
        step[index] = by
        if change == "nav":
            other = state._replace(nav=state.nav.retract(step))
        else:
            other = state._replace(parameter=state.parameter + step)
        return sensor.innovation(measurement, other).y

    found = sensor.innovation(measurement, state)
    for matrix, change in ((found.H, "nav"), (found.J, "parameter")):
        for index in range(matrix.shape[1]):
            numeric = (y(change, index, -STEP) - y(change, index, STEP)) / (2.0 * STEP)
            np.testing.assert_allclose(matrix[:, index], numeric, atol=tolerance * max(1.0, abs(matrix).max()))
    assert found.J.shape == (len(found.y), len(state.parameter))
    assert np.linalg.eigvalsh(found.R).min() > 0.0


def solved(sensor, measurement, state, inflation=1.0):
    """The state that the factor and a prior about `state`, with its covariances, come to."""
    keys = [X] if not state.parameter.size else [X, C]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(sensor.factor(keys, measurement, state, sensor.innovation(measurement, state), inflation))
    graph.add(gtsam.PriorFactorNavState(X, state.nav, gtsam.noiseModel.Gaussian.Covariance(state.covariance)))
    values.insert(X, state.nav)
    if state.parameter.size:
        prior = gtsam.noiseModel.Gaussian.Covariance(state.parameter_covariance)
        graph.add(gtsam.PriorFactorVector(C, state.parameter, prior))
        values.insert(C, state.parameter)
    found = gtsam.GaussNewtonOptimizer(graph, values).optimize()
    parameter = found.atVector(C) if state.parameter.size else state.parameter
    return state._replace(nav=found.atNavState(X), parameter=parameter)
