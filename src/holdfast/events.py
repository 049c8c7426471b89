"""What the estimator tells of itself: what became of measurements, what happened, and how it is."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Outcome(StrEnum):
    """What became of one measurement; those that wait for the IMU are counted at the end."""

    __hash__ = str.__hash__  # five times faster than that of `Enum`; outcomes are counted at every sample

    USED = "used"
    NOT_FINITE = "not_finite"
    OUT_OF_RANGE = "out_of_range"
    DUPLICATE = "duplicate"
    BACKWARD = "backward"
    CLOCK_JUMP = "clock_jump"
    LATE = "late"
    INNOVATION = "innovation"
    WALKING = "walking"
    TOO_FAST = "too_fast"
    BASELINE = "baseline"
    QUARANTINED = "quarantined"
    CONTRADICTED = "contradicted"
    LOW_STATUS = "low_status"
    NO_COVARIANCE = "no_covariance"
    LARGE_COVARIANCE = "large_covariance"
    FROZEN = "frozen"
    BEFORE_START = "before_start"
    NO_JOINT_ANGLE = "no_joint_angle"
    NO_PREDECESSOR = "no_predecessor"
    IGNORED = "ignored"
    OVERLOAD = "overload"
    UNREACHED = "unreached"


class EventKind(StrEnum):
    """What kind of thing happened."""

    INITIALISED = "initialised"
    WAITING = "waiting"
    REJECTED = "rejected"
    LATE = "late"
    OVERLOAD = "overload"
    COVARIANCE_ASSUMED = "covariance_assumed"
    IMU_GAP = "imu_gap"
    CLOCK_STEP = "clock_step"
    RESET = "reset"
    ESTIMATE_SUSPECT = "estimate_suspect"
    BEGUN_ANEW = "begun_anew"
    LEVER_ARM = "lever_arm"
    GNSS_LOST = "gnss_lost"
    GNSS_REGAINED = "gnss_regained"
    RECEIVER_LOST = "receiver_lost"
    RECEIVER_REGAINED = "receiver_regained"
    RECOVERY_REFUSED = "recovery_refused"
    SENSOR_LOST = "sensor_lost"
    SENSOR_REGAINED = "sensor_regained"
    ODOMETRY_JUMP = "odometry_jump"
    ODOMETRY_SLIP = "odometry_slip"
    NOISE = "noise"
    CALIBRATION = "calibration"
    HEALTH = "health"
    OPTIMISER_FAULT = "optimiser_fault"
    ENCODER = "encoder"


@dataclass(frozen=True, slots=True)
class Event:
    """Something that a user may ask about later: when it happened, to which sensor, and why."""

    stamp_ns: int
    kind: EventKind
    sensor: str
    reason: str
    data: Mapping[str, float | str] = field(default_factory=dict)


class Health(StrEnum):
    """How the estimator is, in the order in which one hides another: the first that is true is reported."""

    INITIALISING = "initialising"
    OPTIMISER_RESET = "optimiser_reset"
    IMU_GAP = "imu_gap"
    FALLBACK = "fallback"
    RECOVERING = "recovering"
    ODOMETRY_LOST = "odometry_lost"
    GNSS_DEGRADED = "gnss_degraded"
    LEVER_ARM = "lever_arm"
    SENSOR_LOST = "sensor_lost"
    NOMINAL = "nominal"


@dataclass(frozen=True, slots=True)
class HealthReport:
    """Health at a time, and what it rests on.

    Attributes:
        fused: sensors of which something entered the graph in the last second.
        ages_s: how old the newest measurement that entered is, by sensor.
        noise: of a sensor over what it claims, as its innovations show, where they show that it is another.
    """

    stamp_ns: int
    health: Health
    fused: tuple[str, ...]
    ages_s: Mapping[str, float]
    noise: Mapping[str, float] = field(default_factory=dict)
