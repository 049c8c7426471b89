"""GNSS: which fixes can be believed, what they weigh, and the position factor with the lever arm inside."""

from dataclasses import dataclass

import gtsam
import numpy as np

from holdfast.config.model import GnssConfig
from holdfast.messages import Array, FixStatus, GnssFix
from holdfast.sensors.noise import noise_model
from holdfast.state import Outcome

MAX_ALTITUDE_M = 1e5
MIN_STATUS = {"fix": FixStatus.FIX, "sbas": FixStatus.SBAS, "gbas": FixStatus.GBAS}


@dataclass(frozen=True, slots=True, eq=False)
class AntennaPosition:
    """A checked fix in the world frame: p_W_G (3,) [m] with covariance (3, 3) [m^2] at a stamp, time offset applied."""

    stamp_ns: int
    sensor: str
    p_W_G: Array
    covariance: Array


class GnssModel:
    """One antenna: checks, weights and factors; `p_I_G` (3,) [m] is its lever arm in the IMU's frame."""

    def __init__(self, config: GnssConfig, p_I_G: Array) -> None:
        self.p_I_G = p_I_G
        self.offset_ns = round(config.time_offset_s * 1e9)
        self._config = config

    def check(self, fix: GnssFix) -> Outcome:
        """Say whether a fix can be used, by what the receiver says of it."""
        if not np.isfinite([fix.latitude_deg, fix.longitude_deg, fix.altitude_m]).all():
            return Outcome.LOW_STATUS if fix.status == FixStatus.NO_FIX else Outcome.NOT_FINITE
        if fix.status < MIN_STATUS[self._config.min_status]:
            return Outcome.LOW_STATUS
        if abs(fix.latitude_deg) > 90.0 or abs(fix.longitude_deg) > 360.0 or abs(fix.altitude_m) > MAX_ALTITUDE_M:
            return Outcome.OUT_OF_RANGE
        if fix.covariance is None:
            return Outcome.NO_COVARIANCE if self._config.default_sigma_m is None else Outcome.USED
        variances = np.diag(fix.covariance)
        if not (np.isfinite(fix.covariance).all() and (variances > 0.0).all()):
            return Outcome.NO_COVARIANCE if self._config.default_sigma_m is None else Outcome.USED
        return Outcome.LARGE_COVARIANCE if variances[:2].max() > self._config.max_sigma_m**2 else Outcome.USED

    def covariance(self, fix: GnssFix) -> Array:
        """Return the covariance (3, 3) [m^2] of a checked fix: the receiver's claim above a floor, or the default."""
        claim = fix.covariance
        if claim is None or not (np.isfinite(claim).all() and (np.diag(claim) > 0.0).all()):
            assert self._config.default_sigma_m is not None  # `check` refuses such fixes otherwise
            claim = np.diag(np.square(self._config.default_sigma_m))
        symmetric = 0.5 * (claim + claim.T)
        shortfall = self._config.min_sigma_m**2 - float(np.linalg.eigvalsh(symmetric)[0])
        floored: Array = symmetric + max(0.0, shortfall) * np.eye(3)
        return floored

    def correlation_s(self, position: AntennaPosition) -> float:
        """Return for how long the errors of such fixes are alike: those of float and code solutions for long."""
        is_float = float(position.covariance[:2, :2].max()) > self._config.float_above_m**2
        return self._config.float_correlation_s if is_float else self._config.correlation_s

    def factor(self, key: int, position: AntennaPosition) -> gtsam.NonlinearFactor:
        """Return the factor r = p_W_I + R_W_I p_I_G - p_W_G: (13) in docs/math.md, Eqs. (8)-(9) of the paper."""
        model = noise_model(position.covariance, self._config.robust_loss)
        return gtsam.GPSFactor2Arm(key, position.p_W_G, self.p_I_G, model)
