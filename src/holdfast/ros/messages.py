"""The estimator's output as ROS messages with their topics: the same in a file and on the network."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.chassis.covariances import BaseUncertainty
from holdfast.config.model import Config
from holdfast.events import Health, HealthReport, Outcome
from holdfast.ros.cdr import OdometryEncoder, ros_time
from holdfast.ros.frame_transforms import FrameTransforms
from holdfast.ros.outputs import base_odometry, odometry, seen_from
from holdfast.ros.rows import Rows
from holdfast.state import Estimate

ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
DIAGNOSTICS_PERIOD_NS = 1_000_000_000
BIAS_KEYS = tuple(
    f"bias_{sensor}_{axis}_{unit}" for sensor, unit in (("gyro", "rad_s"), ("accel", "m_s2")) for axis in "xyz"
)
OK, WARN = 0, 1


class RosMessage(NamedTuple):
    """One message of a topic, in CDR."""

    topic: str
    type_name: str
    data: bytes


class EstimateMessages:
    """Encodes estimates: odometry of the IMU in both frames, of the chassis where it is known, and transforms.

    Args:
        config: names the frames.
        node: full name of the node, the `~` of its topics.
    """

    def __init__(self, config: Config, node: str = "/holdfast") -> None:
        frames = config.frames
        self._topics = [f"{node}/odometry/{name}" for name in ("world", "odom", "base")]
        self._uncertainty = BaseUncertainty(config) if config.has_base() else None
        self._in_world = OdometryEncoder(frames.world, config.imu_frame)
        self._in_odometry = OdometryEncoder(frames.odometry, config.imu_frame)
        self._of_base = OdometryEncoder(frames.odometry, frames.base)
        self._transforms = FrameTransforms(config)
        self._rate_density = config.imu.gyroscope_noise_density**2
        self._last_stamp_ns = 0
        self.has_mounts = bool(config.extrinsics)

    @property
    def topics(self) -> dict[str, str]:
        """Every topic that `of` may name, with its type."""
        odometries = self._topics if self._uncertainty is not None else self._topics[:2]
        return dict.fromkeys(odometries, ODOMETRY) | {"/tf": TRANSFORMS}

    def of(self, rows: Rows) -> list[tuple[RosMessage, ...]]:
        """Return the messages of each of some estimates, stamped as it is; ask in order of time."""
        stamps = rows.stamps_ns
        periods_s = np.diff([self._last_stamp_ns, *stamps]).astype(np.float64) * 1e-9
        self._last_stamp_ns = stamps[-1]
        rate_variances = self._rate_density / np.minimum(np.maximum(periods_s, 1e-4), 0.1)
        world = odometry(rows, rows.T_W_I, rate_variances)
        odom = seen_from(world, rows, rows.T_O_I)
        in_world, in_odometry, of_base = self._topics
        found = [
            [RosMessage(in_world, ODOMETRY, data) for data in self._in_world.encode(stamps, *world)],
            [RosMessage(in_odometry, ODOMETRY, data) for data in self._in_odometry.encode(stamps, *odom)],
            [RosMessage("/tf", TRANSFORMS, data) for data in self._transforms.at(rows)],
        ]
        if len(rows.chassis) and self._uncertainty is not None:
            chassis = base_odometry(rows, self._uncertainty, rate_variances)
            found.append([RosMessage(of_base, ODOMETRY, data) for data in self._of_base.encode(stamps, *chassis)])
        return list(zip(*found, strict=True))

    def mounts(self, stamp_ns: int) -> RosMessage:
        """Return the message for /tf_static: what does not move."""
        return RosMessage("/tf_static", TRANSFORMS, self._transforms.mounts(stamp_ns))


class Observed(Protocol):
    """What diagnostics need of an estimator."""

    @property
    def initialised(self) -> bool:
        """Return whether estimates are being given."""

    @property
    def waiting_for(self) -> str:
        """Return what keeps it from starting."""

    @property
    def counts(self) -> Mapping[tuple[str, Outcome], int]:
        """Return the number of measurements by sensor and outcome."""

    def health_report(self) -> HealthReport:
        """Return the health with what it rests on."""


class Status(NamedTuple):
    """One diagnostic_msgs/DiagnosticStatus."""

    level: int
    name: str
    message: str
    values: Sequence[tuple[str, str]] = ()


def estimator_status(estimator: Observed) -> Status:
    """Return the estimator's health: what is fused, how old it is, and the outcome counts of each sensor."""
    report = estimator.health_report()
    values = [("fused", " ".join(report.fused))]
    values += [(f"{sensor} age_s", f"{age_s:.3f}") for sensor, age_s in report.ages_s.items()]
    values += [(f"{sensor} noise_ratio", f"{ratio:.2f}") for sensor, ratio in report.noise.items()]
    values += [(f"{sensor} {outcome}", str(count)) for (sensor, outcome), count in sorted(estimator.counts.items())]
    level = OK if report.health is Health.NOMINAL else WARN
    message = report.health if estimator.initialised else f"{report.health}: {estimator.waiting_for}"
    return Status(level, "holdfast", message, values)


def bias_status(estimate: Estimate) -> Status:
    """Return the biases of the IMU, as they are estimated."""
    biases = (*estimate.bias.gyroscope(), *estimate.bias.accelerometer())
    values = [(key, f"{value:.9g}") for key, value in zip(BIAS_KEYS, biases, strict=True)]
    return Status(OK, "holdfast: biases of the IMU", "", values)


def diagnostic_array(types: Mapping[str, Any], stamp_ns: int, statuses: Sequence[Status]) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray made of `types`, the classes of the standard messages by name."""
    key_value, status_type = types["diagnostic_msgs/msg/KeyValue"], types["diagnostic_msgs/msg/DiagnosticStatus"]
    stamp = types["builtin_interfaces/msg/Time"](*ros_time(stamp_ns))
    return types[DIAGNOSTICS](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
        status=[
            status_type(
                level=status.level,
                name=status.name,
                message=status.message,
                hardware_id="",
                values=[key_value(key=key, value=value) for key, value in status.values],
            )
            for status in statuses
        ],
    )
