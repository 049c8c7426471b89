"""What has been learnt of the sensors, as plain numbers: carried over a restart, and into the next day.

What is carried over is a prior of bounded strength: a sensor may have changed by `CHANGE` in the meantime, or be an
entirely other one, and what was known of it is forgotten as what is learnt now. So it is learnt again within minutes.
"""

from collections.abc import Iterable, Iterator
from math import exp, log
from typing import NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from holdfast.config.section import Section, quantity
from holdfast.errors import ConfigError
from holdfast.messages import Array
from holdfast.sensors.constants import ANOTHER, LearntConstant
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT, LearntJoint

CHANGE = log(1.2)  # sigma of the logarithm by which a noise or a drift is another one after a restart
MOST = 6.0  # of a logarithm: a factor of 400
LOWEST_NOISE, LOWEST_DRIFT = 0.5, 0.4  # scans have errors in common with the next that their noise does not show
LOWEST_TILT = 1.0  # which of them is better odometry and gyroscope do not tell each other
WRONG = log(2.0)  # a number of the configuration that is off by more than this is wrong
SURE = 2.0  # sigmas
GYROSCOPE, ODOMETRY = 0, 1  # of the three scales about the vertical

Scales = tuple[float, float, float]


class LearntScale(Section):
    """A factor on what is configured: mean and sigma of its logarithm."""

    log_mean: float = quantity("1", doc="of the logarithm of the factor", ge=-MOST, le=MOST)
    log_sigma: float = quantity("1", doc="of the logarithm of the factor", gt=0, le=MOST)

    @classmethod
    def of(cls, log_mean: float, log_sigma: float) -> Self:
        """Return a scale as it is believed after a restart."""
        return cls(log_mean=min(max(log_mean, -MOST), MOST), log_sigma=float(np.hypot(log_sigma, CHANGE)))


class Factor(NamedTuple):
    """By how much a number of the configuration is off.

    Attributes:
        what: it is a factor of, in words.
        keys: that it is a factor on.
        value: as it is used.
        log_sigma: of its logarithm.
        is_wrong: it is beyond doubt that the keys are off by more than a factor of two.
    """

    what: str
    keys: tuple[str, ...]
    value: float
    log_sigma: float
    is_wrong: bool

    @classmethod
    def of(cls, what: str, scale: LearntScale, lowest: float, *keys: str) -> Self:
        """Return a factor that is not believed to be below a lowest one."""
        sigma = float(np.sqrt(max(scale.log_sigma**2 - CHANGE**2, 1e-4)))
        log_value = max(log(lowest), scale.log_mean)
        is_wrong = abs(log_value) > WRONG + SURE * sigma
        return cls(what, keys, exp(log_value), sigma, is_wrong)


class LearntYaw(Section):
    """Factors on how wrong gyroscope, odometry and headings turn about the vertical: (72), (73) in docs/math.md."""

    log_means: Scales = Field(description="of the logarithms of the three factors")
    log_covariance: tuple[Scales, Scales, Scales] = Field(description="of the logarithms, 3 x 3")

    @model_validator(mode="after")
    def _check(self) -> Self:
        covariance = np.array(self.log_covariance)
        if max(map(abs, self.log_means)) > MOST:
            raise ValueError(f"log_means: must be within +-{MOST:g}")
        if (covariance != covariance.T).any() or not np.linalg.eigvalsh(covariance)[0] > 1e-6:
            raise ValueError("log_covariance: must be symmetric and positive definite")
        return self

    @classmethod
    def of(cls, log_means: Array, log_covariance: Array) -> Self:
        """Return the scales as they are believed after a restart, given moments (3,) and (3, 3)."""
        covariance = 0.5 * (log_covariance + log_covariance.T) + CHANGE**2 * np.eye(3)
        means = np.clip(log_means, -MOST, MOST)
        return cls(log_means=tuple(means.tolist()), log_covariance=tuple(map(tuple, covariance.tolist())))

    def factor(self, what: str, which: int, *keys: str) -> Factor:
        """Return that of one of the three: the root of the mean of its square, as it is used.

        One that is better than configured is no error of the file, which says it of all axes.
        """
        variance = self.log_covariance[which][which]
        scale = LearntScale(log_mean=self.log_means[which], log_sigma=float(np.sqrt(variance)))
        found = Factor.of(what, scale, exp(-MOST), *keys)
        return found._replace(
            value=found.value * exp(found.log_sigma**2), is_wrong=found.is_wrong and found.value > 1.0
        )


class LearntOdometry(Section):
    """What is learnt of one odometry, where something was."""

    rotation_noise: LearntScale | None = Field(None, description="factor on `rotation_sigma_rad`")
    translation_noise: LearntScale | None = Field(None, description="factor on `translation_sigma_m`")
    rotation_drift: LearntScale | None = Field(None, description="factor on the drift of the rotation")
    translation_drift: LearntScale | None = Field(None, description="factor on the drift of the position")
    yaw: LearntYaw | None = Field(None, description="factors about the vertical")

    def factors(self) -> Iterator[Factor]:
        """Yield the factors that are used for the odometry.

        A rotation that seems better than configured is no error of the file: whose merit it is is known about the
        vertical alone.
        """
        if self.rotation_noise is not None:
            yield Factor.of("rotation noise", self.rotation_noise, LOWEST_NOISE, "rotation_sigma_rad")
        if self.translation_noise is not None:
            yield Factor.of("translation noise", self.translation_noise, LOWEST_NOISE, "translation_sigma_m")
        if self.rotation_drift is not None:
            keys = "drift_rad_per_sqrt_rad", "drift_rad_per_sqrt_m"
            yield Factor.of("rotation drift", self.rotation_drift, LOWEST_TILT, *keys)
        if self.yaw is not None:
            yield self.yaw.factor("yaw drift", ODOMETRY, "drift_rad_per_sqrt_rad")
        if self.translation_drift is not None:
            yield Factor.of("translation drift", self.translation_drift, LOWEST_DRIFT, "drift_m_per_sqrt_m")

    def gyroscope(self) -> Factor | None:
        """Return the factor that is used for the gyroscope about the vertical."""
        if self.yaw is None:
            return None
        keys = "gyroscope_error_ratio", "gyroscope_noise_density"
        return self.yaw.factor("gyroscope, yaw", GYROSCOPE, *keys)


def gyroscope_factor(odometries: Iterable[LearntOdometry]) -> Factor | None:
    """Return the factor that is used for the gyroscope: an error of it shows against each of the odometries."""
    seen = [factor for one in odometries if (factor := one.gyroscope()) is not None]
    return min(seen, key=lambda one: one.value, default=None)


def accelerometer_factor(scale: LearntScale | None) -> Factor | None:
    """Return the factor that is used for the accelerometer in motion.

    One that is better than configured is no error of the file: most are, on smooth ground.
    """
    if scale is None:
        return None
    found = Factor.of("accelerometer in motion", scale, exp(-MOST), "accelerometer_error_ratio")
    value = found.value * exp(found.log_sigma)
    return found._replace(value=value, is_wrong=found.is_wrong and found.value > 1.0)


class LearntNoiseScale(Section):
    """What is learnt of the noise of one sensor that claims its own."""

    log_factor: float = quantity("1", 0.0, doc="of the covariance that it claims, as a logarithm", ge=-MOST, le=MOST)
    white_variance: float | None = quantity("1", None, doc="white part of what it claims", ge=0)
    white_count: int = Field(0, ge=0, description="differences on which that rests")


class LearntNames(Section):
    """Antennas whose positions come by each other's name."""

    antennas: dict[str, str] = Field(
        {}, description="of which antenna the positions by a name are, where not of its own"
    )
    reversed: tuple[str, ...] = Field(
        (), description="headings from one of them to the other that are the other way round"
    )


NAMES_ARE_RIGHT = LearntNames()


class LearntSnapshot(Section):
    """What has been learnt of all sensors, by their names; of constants by that under which the graph knows them."""

    odometries: dict[str, LearntOdometry] = Field({}, description="noise and drift")
    noise: dict[str, LearntNoiseScale] = Field({}, description="of what fixes, headings and others claim")
    constants: dict[str, LearntConstant] = Field({}, description="mountings, clocks and lever arms")
    accelerometer: LearntScale | None = Field(None, description="factor on `accelerometer_error_ratio`")
    joint: LearntJoint = Field(NOTHING_OF_JOINT, description="encoder and mountings at the turn joint")
    names: LearntNames = Field(NAMES_ARE_RIGHT, description="antennas that are exchanged")
    early_ns: dict[str, int] = Field({}, description="by how much clocks are behind that of the IMU, where it is far")

    def updated(self, newer: "LearntSnapshot") -> "LearntSnapshot":
        """Return what was learnt later, and of what nothing was learnt since, this; of the last three always this."""
        return LearntSnapshot(
            odometries={**self.odometries, **newer.odometries},
            noise={**self.noise, **newer.noise},
            constants={**self.constants, **newer.constants},
            accelerometer=newer.accelerometer or self.accelerometer,
            joint=self.joint,
            names=self.names,
            early_ns=self.early_ns,
        )

    def with_joint(self, joint: LearntJoint) -> "LearntSnapshot":
        """Return it with what the IMU path knows of the turn joint, which no graph learns."""
        return self.model_copy(update={"joint": joint})

    def with_names(self, names: LearntNames, early_ns: dict[str, int]) -> "LearntSnapshot":
        """Return it with what is known of names and far clocks beside the graphs."""
        return self.model_copy(update={"names": names, "early_ns": early_ns})

    def without_constants(self) -> "LearntSnapshot":
        """Return what an estimate that was wrong cannot have learnt wrongly."""
        return self.model_copy(update={"constants": {}})


def unless_another(known: Array, configured: Array) -> Array:
    """Return the logarithm of what is believed of scales after a restart, on a grid (...).

    Args:
        known: logarithm of what was known before, up to a constant.
        configured: that of what is believed of a sensor of which only the configuration is known.
    """
    mixed: Array = np.log((1.0 - ANOTHER) * probabilities(known) + ANOTHER * probabilities(configured))
    return mixed


def probabilities(log_weights: Array) -> Array:
    """Return the probabilities on a grid (...) of which logarithms are known up to a constant."""
    weights = np.exp(log_weights - log_weights.max())
    normalised: Array = weights / weights.sum()
    return normalised


NOTHING_LEARNT = LearntSnapshot()


def check_learnt(learnt: object) -> LearntSnapshot:
    """Return what was learnt before, nothing where it is None, and refuse what is neither.

    Raises:
        ConfigError: names the type that came.
    """
    if learnt is None:
        return NOTHING_LEARNT
    if not isinstance(learnt, LearntSnapshot):
        raise ConfigError(f"learnt: must be what `learnt()` of an estimator returns, not {type(learnt).__name__}")
    return learnt
