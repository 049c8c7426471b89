"""GNSS: which fixes can be trusted by what the receiver says of them, and what they weigh."""

from collections.abc import Sequence
from copy import copy
from math import isfinite
from typing import ClassVar, TypeGuard

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import GnssConfig, PrismConfig
from holdfast.events import Outcome
from holdfast.geometry.earth import Geodetic, LocalFrame, is_nowhere
from holdfast.geometry.world import World
from holdfast.messages import Array, FixStatus, GnssFix, Message
from holdfast.sensors.lever_arm import doubtful_arm, is_in_doubt, measured_antennas
from holdfast.sensors.noise import Colour
from holdfast.sensors.position import position_factor, position_innovation
from holdfast.sensors.sensor import (
    ANYWHERE,
    Innovation,
    Measurement,
    Parameter,
    Position,
    Role,
    State,
    innovation_factor,
    is_claim,
    lever_arm,
    register,
)

MAX_ALTITUDE_M = 1e5
STATUS_SIGMA_M = {  # east, north, up, from datasheets: RTK fixed, corrected by satellite, alone
    FixStatus.GBAS: (0.02, 0.02, 0.04),
    FixStatus.SBAS: (0.8, 0.8, 1.5),
    FixStatus.FIX: (2.5, 2.5, 4.0),
}
SLOW_DISTANCE_M = 3.0  # over which multipath of a carrier phase is another one
WHITE_CORRELATION_S = 0.05  # of what is white: receivers have filters inside
MIN_STATUS = {"fix": FixStatus.FIX, "sbas": FixStatus.SBAS, "gbas": FixStatus.GBAS}


def _resolved(time_constant_s: float) -> Colour:
    """Return the colour of a fix whose ambiguities are resolved, before successive fixes have told what is white."""
    return Colour(
        0.5,
        0.5,
        time_constant_s,
        distance_constant_m=SLOW_DISTANCE_M,
        white_correlation_s=WHITE_CORRELATION_S,
    )


class GnssModel:
    """One antenna; `p_I_P` (3,) [m] is its lever arm in the IMU's frame."""

    role: ClassVar[Role] = Role.POSITION
    message: ClassVar[type[Message] | None] = GnssFix

    def __init__(self, name: str, config: GnssConfig, p_I_P: Array) -> None:
        self.name = name
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.p_I_P = p_I_P
        self.parameters: tuple[Parameter, ...] = (measured_antennas(),)
        self.limit = config.gate_sigma**2
        self.loss, self.offset_sigma_s = config.robust_loss, config.time_offset_sigma_s
        self._config = config
        self._colour = _resolved(config.slow_time_constant_s) if config.slow_size else None

    def with_arm(self, shift: Parameter) -> "GnssModel":
        """Return a model of the same antenna whose lever arm is where it is known to be, but for a shift."""
        other = copy(self)
        other.p_I_P, other.parameters = self.p_I_P + shift.mean, (shift._replace(mean=np.zeros(3)),)
        return other

    def with_known_arm(self) -> "GnssModel":
        """Return a model of the same antenna whose lever arm is known."""
        other = copy(self)
        other.parameters = ()
        return other

    def convert(self, fix: GnssFix, world: World) -> Position | Outcome:
        """Return the fix in W, or what is wrong with it."""
        outcome = self.check(fix)
        if outcome is not Outcome.USED:
            return outcome
        p_W_P = world.to_enu(point_of(fix))
        covariance = self._covariance(fix)
        is_float = float(covariance[:2, :2].max()) > self._config.float_above_m**2
        correlation_s = self._config.float_correlation_s if is_float else self._config.correlation_s
        colour = None if is_float else self._colour  # a receiver that is not sure jumps, too
        return Position(fix.stamp_ns + self.offset_ns, self.name, p_W_P, covariance, correlation_s, colour)

    def check(self, fix: GnssFix) -> Outcome:
        """Say whether a fix can be used, by what the receiver says of it."""
        if not isfinite(fix.latitude_deg + fix.longitude_deg + fix.altitude_m):
            return Outcome.LOW_STATUS if fix.status == FixStatus.NO_FIX else Outcome.NOT_FINITE
        if is_nowhere(point_of(fix)):
            return Outcome.LOW_STATUS  # whatever its status
        if fix.status < MIN_STATUS[self._config.min_status]:
            return Outcome.LOW_STATUS
        if abs(fix.latitude_deg) > 90.0 or abs(fix.longitude_deg) > 360.0 or abs(fix.altitude_m) > MAX_ALTITUDE_M:
            return Outcome.OUT_OF_RANGE
        if not is_claim(fix.covariance):
            return Outcome.NO_COVARIANCE if self._assumed_sigma_m(fix) is None else Outcome.USED
        is_large = max(fix.covariance[0, 0], fix.covariance[1, 1]) > self._config.max_sigma_m**2
        return Outcome.LARGE_COVARIANCE if is_large else Outcome.USED

    def assumption(self, fix: GnssFix) -> str:
        """Return what is assumed of a usable fix; empty if it claims a covariance or the configuration gives one."""
        if is_claim(fix.covariance) or self._config.default_sigma_m is not None:
            return ""
        east, north, up = STATUS_SIGMA_M[fix.status]
        return (
            f"fixes of status {fix.status.name.lower()} come without a covariance: sigmas of {east:g}, {north:g}, "
            f"{up:g} m are assumed; sensors.{self.name}.default_sigma_m sets them"
        )

    def _assumed_sigma_m(self, fix: GnssFix) -> tuple[float, float, float] | None:
        """Return what stands in for a claim: the configured sigmas, or those of the status; None for a broken claim."""
        is_unknown = fix.covariance is None or not fix.covariance.any()
        return self._config.default_sigma_m or (STATUS_SIGMA_M[fix.status] if is_unknown else None)

    def _covariance(self, fix: GnssFix) -> Array:
        """Return the covariance (3, 3) [m^2] of a checked fix: the receiver's claim above a floor, or its stand-in."""
        claim = fix.covariance
        if not is_claim(claim):
            claim = np.diag(np.square(self._assumed_sigma_m(fix) or (0.0, 0.0, 0.0)))  # `check` refuses it otherwise
        symmetric = 0.5 * (claim + claim.T)
        is_diagonal = np.count_nonzero(symmetric) == 3
        smallest = symmetric.diagonal().min() if is_diagonal else np.linalg.eigvalsh(symmetric)[0]
        shortfall = self._config.min_sigma_m**2 - float(smallest)
        floored: Array = symmetric + max(0.0, shortfall) * np.eye(3)
        return floored

    def innovation(self, position: Position, state: State) -> Innovation:
        """Compare a fix with a state."""
        return position_innovation(position, state, self.p_I_P)

    def factor(
        self, keys: Sequence[int], position: Position, inflation: float, state: State = ANYWHERE
    ) -> gtsam.NonlinearFactor:
        """Return the factor of a fix on a node, and on the shift of its arm if that is estimated."""
        if len(keys) == 1:
            return position_factor(keys[0], position, self.p_I_P, self.loss, inflation)
        return innovation_factor(self, keys, position, state, position.covariance * inflation, self.loss)


def point_of(fix: GnssFix) -> Geodetic:
    """Return where a fix says that its antenna is."""
    return Geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m)


def claimed_position(message: Message, measurement: Measurement | Outcome, frame: LocalFrame | None) -> Array | None:
    """Return where in W (3,) a message says that an antenna is, also one that was refused; None if it does not."""
    if isinstance(measurement, Position):
        return measurement.p_W_P
    if not isinstance(message, GnssFix) or frame is None or not all(map(isfinite, point := point_of(message))):
        return None
    return frame.to_enu(point)


def is_measured(sensor: object) -> TypeGuard[GnssModel]:
    """Whether a sensor is an antenna whose lever arm is estimated, as it was measured or far off."""
    return isinstance(sensor, GnssModel) and bool(sensor.parameters) and not is_in_doubt(sensor.parameters)


def _configured(name: str, section: GnssConfig, config: Config) -> GnssModel:
    model, sigma_m = GnssModel(name, section, lever_arm(name, config)), section.lever_arm_sigma_m
    if sigma_m == 0.0 or (sigma_m is None and config.sensors_of(PrismConfig)):
        return model.with_known_arm()  # of a prism and an antenna that contradict, nobody knows which is elsewhere
    return model if sigma_m is None else model.with_arm(doubtful_arm(np.full(3, sigma_m)))


register(GnssConfig, _configured)
