"""The joint covariance at the end of a window: of the newest node, its bias, and the newest slow errors of sensors.

It is read from the solver after every optimisation and predicted from there, so that judging what comes next costs no
marginal.
"""

from typing import NamedTuple

import numpy as np

from holdfast.graph.chain import Prediction
from holdfast.graph.slow_errors import Step
from holdfast.messages import Array
from holdfast.sensors.coloured import NAV_SIZE

BIAS_END = 15  # of a node and its bias


class Tail(NamedTuple):
    """`covariance` (15 + n, 15 + n): of the node (9), of the bias (6), of the slow errors (n)."""

    covariance: Array

    @property
    def node(self) -> Array:
        """The covariance (9, 9) of the node."""
        return self.covariance[:NAV_SIZE, :NAV_SIZE]

    @property
    def state(self) -> Array:
        """The covariance (15, 15) of the node and its bias."""
        return self.covariance[:BIAS_END, :BIAS_END]

    def moved(self, next_node: Prediction) -> "Tail":
        """Return that of the next node."""
        F = np.eye(len(self.covariance))
        F[:NAV_SIZE, :NAV_SIZE], F[:NAV_SIZE, NAV_SIZE:BIAS_END] = next_node.H_nav, next_node.H_bias
        covariance = F @ self.covariance @ F.T
        covariance[:NAV_SIZE, :NAV_SIZE] += next_node.added
        return Tail(covariance)

    def with_epoch(self, step: Step) -> "Tail":
        """Return that with the slow errors of an epoch that was just made."""
        end = BIAS_END + len(step.decay)
        covariance, known = np.zeros((end, end)), len(self.covariance)
        covariance[:known, :known] = self.covariance
        covariance[BIAS_END:] *= step.decay[:, None]
        covariance[:, BIAS_END:] *= step.decay
        covariance[BIAS_END:, BIAS_END:] += np.diag(step.variance)
        return Tail(covariance)

    def without_slow_errors(self) -> "Tail":
        """Return that of node and bias alone."""
        return Tail(self.state)


def node_beside(joint: Array, first: int, end: int) -> Array:
    """Return the part (9 + m, 9 + m) of a joint covariance: of its first nine rows, a node, and of m others."""
    node, others, size = slice(NAV_SIZE), slice(first, end), NAV_SIZE + end - first
    covariance = np.empty((size, size))
    covariance[node, node] = joint[node, node]
    covariance[node, NAV_SIZE:] = joint[node, others]
    covariance[NAV_SIZE:, node] = joint[others, node]
    covariance[NAV_SIZE:, NAV_SIZE:] = joint[others, others]
    return covariance
