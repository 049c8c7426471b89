"""The newest optimised state, carried to each sample of the IMU with its biases, its covariance and the chassis.

After each optimisation the samples since that node are propagated again (paper, IV-B). The work is done by
`holdfast.kernel.imu_path`, of which this owns the records.
"""

from math import sqrt
from typing import Any

import gtsam
import numpy as np

from holdfast.chassis.kinematics import BaseKinematics
from holdfast.config.model import Config
from holdfast.kernel import imu_path as kernel
from holdfast.kernel import layout
from holdfast.messages import ImuSample
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import MOTION_CORRELATION_S, MOTION_INTEGRATION_SIGMA
from holdfast.state import OptimisedState

NO_RING = np.zeros((0, 0), np.int64), np.zeros((0, 0))


class Predictor:
    """Takes samples of the IMU into the buffer, and carries the state to each.

    Attributes:
        values: what `process` publishes, laid out as `PUBLISHED`; overwritten by the next.
        is_running: whether there is a state.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        ring: rows shared with another process, as integers and as doubles, into which usual samples are written.
    """

    def __init__(self, config: Config, buffer: ImuBuffer, ring: tuple[Any, Any] = NO_RING) -> None:
        self._buffer, self._ring = buffer, ring
        self._path, self._propagations = np.zeros(1, layout.PATH), np.zeros(2, layout.PROPAGATION)
        self._work = np.zeros(1, layout.WORK)
        self._fill(config)
        self._state: tuple[Any, ...] = ()  # what all functions of the kernel work on
        self._records: tuple[Any, ...] = ()  # and what `process` does
        self.values = self._path["published"].view(np.float64)
        self.is_running = False

    def _fill(self, config: Config) -> None:
        """Write into the records what is configured."""
        one, imu, motion = self._path[0], config.imu, config.motion_model
        densities = imu.accelerometer_noise_density, imu.gyroscope_noise_density
        one["offset_ns"], one["has_imu"] = self._buffer.offset_ns, 1
        one["accelerometer_density"], one["gyroscope_density"] = densities
        one["force_error"] = imu.accelerometer_error_ratio * sqrt(MOTION_CORRELATION_S)
        one["rate_error"] = imu.gyroscope_error_ratio * sqrt(MOTION_CORRELATION_S)
        one["imu_noise"] = np.square([*densities, config.graph.position_integration_sigma])
        moving = motion.acceleration_density, motion.angular_rate_density, MOTION_INTEGRATION_SIGMA
        one["motion_noise"] = np.square(moving)
        one["walk"] = np.repeat(np.square([imu.accelerometer_random_walk, imu.gyroscope_random_walk]), 3)
        one["frame"]["always"] = config.frames.odometry_policy == "always"

    def carry(self, chassis: BaseKinematics) -> None:
        """Let the state of a chassis be carried along."""
        self._chassis = chassis.records
        self._collect()

    def release_ring(self) -> None:
        """Let go of the memory that is shared with another process."""
        self._ring = NO_RING
        self._collect()

    def _collect(self) -> None:
        buffer = self._buffer
        self._state = self._path, self._propagations, buffer.record, buffer.samples, buffer.blocks, self._work
        self._records = *self._state, *self._chassis, *self._ring

    @property
    def stamp_ns(self) -> int:
        """Time that the newest state has reached."""
        return int(self._newest["stamp_ns"])

    @property
    def has_imu(self) -> bool:
        """Whether the IMU measured until the newest sample."""
        return bool(self._path[0]["has_imu"])

    @property
    def _newest(self) -> Any:
        return self._propagations[self._path[0]["newest"]]

    def process(self, sample: ImuSample, number: int, epoch: int) -> int:
        """Take in a sample, if it is a usual one; return what came of it, in flags of `holdfast.kernel.imu_path`.

        Args:
            sample: in continuous time.
            number: of its row in the ring.
            epoch: for that row.
        """
        reading = *sample.specific_force.tolist(), *sample.angular_velocity.tolist()
        stamp_ns = sample.stamp_ns + self._buffer.offset_ns
        flags = kernel.process(*self._records, number, epoch, stamp_ns, sample.arrival_ns, reading, False)
        return self._catch_up(flags) if flags & kernel.IS_PENDING else flags

    def process_checked(self, sample: ImuSample) -> int:
        """Take in an unusual sample that has been checked, and leave it to the caller to pass it on."""
        self._buffer.make_room()
        self._collect()
        reading = *sample.specific_force.tolist(), *sample.angular_velocity.tolist()
        stamp_ns = sample.stamp_ns + self._buffer.offset_ns
        flags = kernel.process(*self._records, 0, 0, stamp_ns, sample.arrival_ns, reading, True)
        return self._catch_up(flags) if flags & kernel.IS_PENDING else flags

    def _catch_up(self, flags: int) -> int:
        found: int = kernel.catch_up(*self._state, *self._chassis, flags)
        return found

    def begin(self, state: OptimisedState, gravity: float) -> None:
        """Begin with a first state, gravity in m/s^2; O is where W is."""
        self._path[0]["gravity"] = gravity
        self._put(state)
        kernel.anchor(*self._state, True, False)
        self.is_running = True

    def anchor(self, state: OptimisedState, *, is_recovery: bool = False) -> None:
        """Continue from a new optimised state: propagate the samples since its stamp again."""
        self._put(state)
        kernel.anchor(*self._state, False, is_recovery)

    def settle(self) -> OptimisedState:
        """Let the propagated state take the place of the optimised one, and return it."""
        kernel.settle(*self._state)
        first = self._newest["optimised"]
        nav = gtsam.NavState(gtsam.Rot3(first["nav"]["R"]), first["nav"]["p"], first["nav"]["v"])
        bias = gtsam.imuBias.ConstantBias(first["bias_accel"], first["bias_gyro"])
        return OptimisedState(int(first["stamp_ns"]), nav, bias, first["P"].copy(), first["rate"].copy())

    def stop(self) -> None:
        """Take in samples, but give no estimates until the next start."""
        self._path[0]["is_running"] = 0
        self.is_running = False

    def _put(self, state: OptimisedState) -> None:
        incoming, nav = self._path[0]["incoming"], state.nav
        incoming["stamp_ns"], incoming["P"], incoming["rate"] = state.stamp_ns, state.covariance, state.angular_velocity
        incoming["nav"] = nav.attitude().matrix(), nav.position(), nav.velocity()
        incoming["bias_accel"], incoming["bias_gyro"] = state.bias.accelerometer(), state.bias.gyroscope()
