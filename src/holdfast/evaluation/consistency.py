"""Are the covariances consistent? Normalised estimation error squared (NEES) and its chi-square bounds.

Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4.
"""

from dataclasses import dataclass
from math import exp, lgamma, log, sqrt
from statistics import NormalDist

import numpy as np

from holdfast.covariances import Covariances, correlation_eigenvalues
from holdfast.errors import EstimatorError
from holdfast.evaluation.association import Pairs
from holdfast.evaluation.states import States, state_errors
from holdfast.messages import Array


@dataclass(frozen=True, slots=True)
class Consistency:
    """How well covariances explain errors.

    Attributes:
        mean_nees_per_dof: 1 for a consistent estimator, more for an overconfident one.
        lower_per_dof: lower end of the interval in which mean_nees_per_dof of `count` independent errors lies with the
            given probability; the mean of errors that are correlated in time, as those of a filter, varies more.
        upper_per_dof: upper end of it.
        fraction_inside: fraction of the single errors whose NEES is below the chi-square quantile of that probability;
            the probability itself for a consistent estimator.
    """

    count: int
    dof: int
    probability: float
    mean_nees_per_dof: float
    lower_per_dof: float
    upper_per_dof: float
    fraction_inside: float

    @property
    def consistent(self) -> bool:
        """Whether the mean is within its bounds."""
        return self.lower_per_dof <= self.mean_nees_per_dof <= self.upper_per_dof


def nees(errors: Array, covariances: Array) -> Array:
    """Return e^T P^-1 e (N,) for errors (N, d) with covariances (N, d, d), in any units that belong together.

    Raises:
        EstimatorError: the shapes do not belong together, or a covariance is not positive definite.
    """
    count, dof = errors.shape
    if covariances.shape != (count, dof, dof):
        raise EstimatorError(f"errors {errors.shape} need covariances {(count, dof, dof)}, not {covariances.shape}")
    positive = correlation_eigenvalues(covariances) > 0.0
    if not positive.all():
        raise EstimatorError(f"covariance {int(np.flatnonzero(~positive)[0])} is not positive definite")
    whitened = np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]
    values: Array = np.einsum("ij,ij->i", errors, whitened)
    return values


def consistency(errors: Array, covariances: Array, probability: float = 0.95) -> Consistency:
    """Judge errors (N, d) by their covariances (N, d, d); errors raised as in `nees`."""
    count, dof = errors.shape
    values = nees(errors, covariances)
    tail = (1.0 - probability) / 2.0
    return Consistency(
        count=count,
        dof=dof,
        probability=probability,
        mean_nees_per_dof=float(values.mean()) / dof,
        lower_per_dof=chi_square_quantile(tail, count * dof) / (count * dof),
        upper_per_dof=chi_square_quantile(1.0 - tail, count * dof) / (count * dof),
        fraction_inside=float((values <= chi_square_quantile(probability, dof)).mean()),
    )


def chi_square_quantile(probability: float, dof: int) -> float:
    """Return the value below which a chi-square variable of `dof` degrees of freedom is with this probability.

    Bisection on the distribution function, in a bracket grown around the approximation of Wilson and Hilferty (1931).

    Raises:
        EstimatorError: the probability is not within (0, 1), or dof is below 1.
    """
    if not 0.0 < probability < 1.0 or dof < 1:
        raise EstimatorError(
            f"chi-square quantile of {probability} at {dof} degrees: needs 0 < probability < 1, dof >= 1"
        )
    variance = 2.0 / (9.0 * dof)
    guess = dof * max(1e-3, 1.0 - variance + NormalDist().inv_cdf(probability) * sqrt(variance)) ** 3
    low, high = guess, guess
    while chi_square_cdf(low, dof) > probability:
        low /= 1.1
    while chi_square_cdf(high, dof) < probability:
        high *= 1.1
    while (middle := (low + high) / 2.0) not in (low, high):
        low, high = (middle, high) if chi_square_cdf(middle, dof) < probability else (low, middle)
    return middle


def chi_square_cdf(value: float, dof: int) -> float:
    """Return the probability that a chi-square variable is below the value: the regularised incomplete gamma function.

    Series below the mean, continued fraction by Lentz's method above it (Numerical Recipes, 3rd ed., section 6.2).
    """
    a, x = dof / 2.0, value / 2.0
    if x <= 0.0:
        return 0.0
    front = exp(a * log(x) - x - lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        n = a
        while term > total * 1e-17:
            n += 1.0
            term *= x / n
            total += term
        return front * total
    return 1.0 - front * _upper_fraction(a, x)


def _upper_fraction(a: float, x: float) -> float:
    b = x + 1.0 - a
    c, d = 1e300, 1.0 / b
    fraction, n, change = d, 0, 0.0
    while abs(change - 1.0) > 1e-15:
        n += 1
        numerator = n * (a - n)
        b += 2.0
        d = 1.0 / (numerator * d + b)
        c = b + numerator / c
        change = c * d
        fraction *= change
    return fraction


def pose_consistency(pairs: Pairs, covariances: Covariances, probability: float = 0.95) -> dict[str, Consistency]:
    """Judge the poses of an estimate by their covariances: `position`, and `attitude` where both are oriented.

    Raises:
        EstimatorError: a covariance is not positive definite.
    """
    still = np.zeros_like(pairs.estimate.positions)
    errors = state_errors(States(pairs.estimate, still), States(pairs.reference, still)).tangent
    claimed = covariances.at(pairs.estimate.stamps_ns)
    blocks = {"position": slice(3, 6)} | ({"attitude": slice(0, 3)} if pairs.oriented else {})
    return {
        name: consistency(errors[:, block], claimed[:, block, block], probability) for name, block in blocks.items()
    }
