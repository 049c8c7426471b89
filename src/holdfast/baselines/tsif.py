"""TSIF: the two-state implicit filter with residuals of the IMU and of GNSS.

Bloesch, Burri, Sommer, Siegwart, Hutter, "The Two-State Implicit Filter: Recursive Estimation for Mobile Robots",
RA-L 3(1), 2018. There is no process model and no measurement model, only residuals between the state before and the
state now; a step minimises them together with the prior and marginalises the state before. As in the comparison of the
excavator paper, IMU and GNSS are its only sensors.

The state (15,) is that of `holdfast.state`; the belief is kept as information, the inverse of the covariance.
"""

from math import inf

import gtsam
import numpy as np

from holdfast.baselines.baseline import Baseline
from holdfast.baselines.filtering import FilterSystem
from holdfast.baselines.intake import Intake, Measurement, PositionFix
from holdfast.baselines.propagation import Propagation, Tuning
from holdfast.baselines.start import Start
from holdfast.config.model import Config
from holdfast.events import Outcome
from holdfast.messages import Array

CHI_SQUARE_3 = 16.27  # one good fix in a thousand exceeds it
ITERATIONS = 5
CONVERGED = 1e-7


class TsifBelief:
    """State and information (15, 15)."""

    __slots__ = ("bias", "bias_accel", "bias_gyro", "information", "nav", "stamp_ns")

    def __init__(
        self, stamp_ns: int, nav: gtsam.NavState, bias: gtsam.imuBias.ConstantBias, information: Array
    ) -> None:
        self.stamp_ns, self.nav, self.information = stamp_ns, nav, information
        self.set_bias(bias)

    def set_bias(self, bias: gtsam.imuBias.ConstantBias) -> None:
        """Set the bias and its two halves."""
        self.bias, self.bias_accel, self.bias_gyro = bias, bias.accelerometer(), bias.gyroscope()

    def copy(self) -> "TsifBelief":
        """Return a copy that goes on by itself; its information is replaced as a whole, never changed in place."""
        return TsifBelief(self.stamp_ns, self.nav, self.bias, self.information)

    def nav_covariance(self) -> Array:
        """Return the covariance (9, 9) of `nav`."""
        return self.covariance()[:9, :9]

    def covariance(self) -> Array:
        """Return the covariance (15, 15) of `nav` and `bias`."""
        inverse = np.linalg.inv(self.information)
        covariance: Array = 0.5 * (inverse + inverse.T)
        return covariance


class TsifFilter:
    """Steps from one state to the next, and measurement residuals on the newest."""

    def __init__(self, tuning: Tuning) -> None:
        self._inflation = tuning.fix_inflation
        self._limit = CHI_SQUARE_3 if tuning.rejects_outliers else inf
        self._W = np.zeros((15, 15))

    def predict(self, belief: TsifBelief, model: Propagation) -> None:
        """Marginalise the state before, given the IMU's residuals to the state now.

        The residual f(x_before)^-1 x_now is zero at the mean that `model` has predicted, so that only the information
        changes. Its derivatives are -F and the identity, its weight W = Q^-1.
        """
        W = self._W
        W[:9, :9] = np.linalg.inv(model.Q)
        W.ravel()[9 * 16 :: 16] = 1.0 / model.walk
        WF = W @ model.F
        belief.information = marginalised(belief.information, model.F.T @ WF, WF, W)

    def update(self, belief: TsifBelief, measurement: Measurement) -> Outcome:
        """Minimise the residual of a fix together with the prior by Gauss-Newton, unless the fix is an outlier."""
        fix = measurement.content
        assert isinstance(fix, PositionFix)
        prior = belief.nav
        weight = np.linalg.inv(fix.position.covariance * self._inflation)
        residual, H = _position_residual(prior, fix)
        predicted = H @ np.linalg.solve(belief.information, H.T)
        if residual @ np.linalg.solve(predicted + fix.position.covariance, residual) > self._limit:
            return Outcome.INNOVATION
        moved = np.zeros(15)
        for _ in range(ITERATIONS):
            information = belief.information + H.T @ weight @ H
            gradient = H.T @ weight @ residual - belief.information @ moved
            step = np.linalg.solve(information, gradient)
            moved = moved + step
            nav = prior.retract(moved[:9])
            if abs(step).max() < CONVERGED:
                break
            residual, H = _position_residual(nav, fix)
        belief.nav, belief.information = nav, information
        belief.set_bias(gtsam.imuBias.ConstantBias(belief.bias_accel + moved[9:12], belief.bias_gyro + moved[12:]))
        return Outcome.USED


def marginalised(prior: Array, before: Array, between: Array, now: Array) -> Array:
    """Return the information (n, n) of the state now after the state before is marginalised.

    Residuals J_b dx_b + J_n dx_n with weight W, and a prior on dx_b, have the normal equations
    [[prior + J_b^T W J_b, J_b^T W J_n], [J_n^T W J_b, J_n^T W J_n]], whose Schur complement is returned.

    Args:
        prior: (n, n) information of the state before.
        before: J_b^T W J_b.
        between: J_n^T W J_b, whatever its sign.
        now: J_n^T W J_n.
    """
    information: Array = now - between @ np.linalg.solve(prior + before, between.T)
    return 0.5 * (information + information.T)


def _position_residual(nav: gtsam.NavState, fix: PositionFix) -> tuple[Array, Array]:
    """Return p_W_P - (p_W_I + R_W_I p_I_P) (3,), and the derivative (3, 15) of the predicted position."""
    R = nav.attitude().matrix()
    H = np.zeros((3, 15))
    H[:, :3], H[:, 3:6] = -R @ gtsam.SO3.Hat(fix.p_I_P), R
    return fix.position.p_W_P - nav.position() - R @ fix.p_I_P, H


TSIF_TUNING = Tuning(acceleration=0.2, angular_rate_rad_s=0.1, fix_inflation=10.0, rejects_outliers=False)


def make_tsif(config: Config, tuning: Tuning = TSIF_TUNING) -> Baseline:
    """Return TSIF for a machine.

    Raises:
        ConfigError: the machine measures no position.
    """
    return Baseline(config, lambda config, intake: FilterSystem(config, intake, _start, False, tuning))


def _start(tuning: Tuning, intake: Intake, start: Start) -> tuple[TsifFilter, TsifBelief]:  # noqa: ARG001 (no odometry)
    information: Array = np.asarray(np.linalg.inv(start.covariance), dtype=np.float64)
    return TsifFilter(tuning), TsifBelief(start.stamp_ns, start.nav, start.bias, information)
