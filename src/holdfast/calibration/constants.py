"""What several runs know of a constant of a sensor together."""

from collections.abc import Iterable, Sequence

import numpy as np

from holdfast.calibration.evidence import Evidence
from holdfast.messages import Array
from holdfast.sensors.constants import Constant


def of_name(evidence: Iterable[Evidence], name: str) -> list[Constant]:
    """Return what the runs know of a constant, one entry for each start of the estimator that knew it."""
    return [start[name] for one in evidence for start in one.constants if name in start]


def combined(constants: Sequence[Constant]) -> tuple[Array, Array]:
    """Return difference to the configuration (p,) and covariance (p, p) of all, the prior counted once: (55)."""
    prior = np.diag(constants[0].prior.sigmas ** -2.0)
    information, weighted = prior.copy(), np.zeros(len(prior))
    for one in constants:
        measured = np.linalg.inv(one.covariance)
        information += measured - prior
        weighted += measured @ (one.measured - one.prior.mean)
    covariance: Array = np.asarray(np.linalg.inv(information))
    return covariance @ weighted, covariance
