"""What a smoother knows of the parameters of one sensor, one behind the other."""

from typing import Any

import numpy as np

from holdfast.graph.smoother import Smoother
from holdfast.messages import Array
from holdfast.sensors.sensor import State


def with_parameters(
    smoother: Smoother, sensor: Any, state: State, stamp_ns: int, start: Array | None = None
) -> tuple[list[int], State]:
    """Return the keys of a sensor's parameters for a factor at a time, and a state with their estimate.

    `start` (p,) is where new ones are linearised; without it at the means of their priors.
    """
    keys, values, covariances, first = [], [], [], 0
    for prior in sensor.parameters:
        own = None if start is None else start[first : first + len(prior.mean)]
        key, value, covariance = smoother.parameter(prior.name(sensor.name), prior, stamp_ns, own)
        keys.append(key)
        values.append(value)
        covariances.append(covariance)
        first += len(value)
    return keys, _with(state, values, covariances)


def with_beliefs(smoother: Smoother, sensor: Any, state: State) -> State:
    """Return a state with what is believed of a sensor's parameters, their priors where they are no variables yet."""
    beliefs = [smoother.parameters.belief(prior.name(sensor.name), prior) for prior in sensor.parameters]
    return _with(state, [value for value, _ in beliefs], [covariance for _, covariance in beliefs])


def believed_parameters(smoother: Smoother, sensor: Any) -> Array:
    """Return what is believed of a sensor's parameters (p,)."""
    beliefs = [smoother.parameters.belief(prior.name(sensor.name), prior)[0] for prior in sensor.parameters]
    return np.concatenate([np.zeros(0), *beliefs])


def _with(state: State, values: list[Array], covariances: list[Array]) -> State:
    if not values:
        return state
    if len(values) == 1:
        return state._replace(parameter=values[0], parameter_covariance=covariances[0])
    parameter, first = np.concatenate(values), 0
    joint = np.zeros((len(parameter), len(parameter)))
    for covariance in covariances:
        last = first + len(covariance)
        joint[first:last, first:last] = covariance
        first = last
    return state._replace(parameter=parameter, parameter_covariance=joint)
