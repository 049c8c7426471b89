"""What several runs know of a constant of a sensor together."""

from collections.abc import Iterable, Sequence
from math import log

import numpy as np

from holdfast.calibration.evidence import Evidence
from holdfast.messages import Array
from holdfast.sensors.constants import Constant

ODDS = log(3.0)


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


def is_off(off: float, sigma: float, prior: float, if_right: float) -> bool:
    """Whether an estimate is more plausibly off than right, given the sigmas of both: (54) in docs/math.md."""
    right, wrong = sigma**2 + if_right**2, sigma**2 + prior**2
    ratio = -0.5 * (off**2 / right + log(right)) + 0.5 * (off**2 / wrong + log(wrong))
    return ratio < -ODDS
