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
from holdfast.sensors.imu import ImuBuffer, as_doubles
from holdfast.sensors.preintegration import MOTION_CORRELATION_S, MOTION_INTEGRATION_SIGMA
from holdfast.state import OptimisedState

FAR_NS = 1 << 62  # a stamp after all others


class Predictor:
    """Takes samples of the IMU into the buffer, and carries the state to each.

    Attributes:
        address: of the `PATH`, for functions of the kernel.
        shared: what the path knows of another process, a `SHARED`.
        copy_row: returns what was published last, laid out as `PUBLISHED`.
        is_running: whether there is a state.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
    """

    def __init__(self, config: Config, buffer: ImuBuffer) -> None:
        self._buffer = buffer
        self._path, self._propagations = np.zeros(1, layout.PATH), np.zeros(2, layout.PROPAGATION)
        self._work = np.zeros(1, layout.WORK)
        self.address: int = self._path.ctypes.data
        self.shared: Any = self._path[0]["shared"]
        self._fill(config)
        self._note_addresses(propagations_at=self._propagations, buffer_at=buffer.record, work_at=self._work)
        self.copy_row = memoryview(self._path["published"].view(np.float64).data).cast("B").tobytes
        self.is_running = False

    def _note_addresses(self, **records: Any) -> None:
        """Write down where records lie; who gives them keeps them."""
        for name, record in records.items():
            self._path[0][name] = record.ctypes.data

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
        one["shared"]["rescue_ns"] = FAR_NS
        one["frame"]["always"] = config.frames.odometry_policy == "always"

    def carry(self, chassis: BaseKinematics) -> None:
        """Let the state of a chassis be carried along."""
        self._chassis = chassis.records
        mount, joint, rotations, waiting = chassis.records
        self._note_addresses(mount_at=mount, joint_at=joint, rotations_at=rotations, waiting_at=waiting)
        self._path[0]["rotation_rows"], self._path[0]["waiting_rows"] = len(rotations), len(waiting)

    def read_clock(self, offset_ns: int) -> None:
        """Subtract an offset from the stamps of samples to come."""
        self._path[0]["clock_ns"] = offset_ns

    def take_count(self) -> int:
        """Return how many samples were used since the last call."""
        used, self._path[0]["used"] = int(self._path[0]["used"]), 0
        return used

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

    def process(self, sample: ImuSample, *, is_checked: bool = False) -> int:
        """Take in a sample, if it is a usual one; return what came of it, in flags of `holdfast.kernel.imu_path`.

        Args:
            sample: with the stamp that the clock of the IMU gave.
            is_checked: an unusual one, with its stamp in continuous time, that may be used.
        """
        force = as_doubles(sample.specific_force, "specific_force")
        rate = as_doubles(sample.angular_velocity, "angular_velocity")
        if is_checked:
            self._buffer.make_room()
        flags: int = kernel.process(self.address, sample.stamp_ns, sample.arrival_ns, force, rate, is_checked)
        return flags

    def catch_up(self, flags: int) -> int:
        """Carry the state to a sample that `process` has left pending."""
        found: int = kernel.catch_up(self.address, flags)
        return found

    def begin(self, state: OptimisedState, gravity: float) -> None:
        """Begin with a first state, gravity in m/s^2; O is where W is."""
        self._path[0]["gravity"] = gravity
        self._put(state)
        kernel.anchor(self.address, True, False)
        self.is_running = True

    def anchor(self, state: OptimisedState, *, is_recovery: bool = False) -> None:
        """Continue from a new optimised state: propagate the samples since its stamp again."""
        self._put(state)
        kernel.anchor(self.address, False, is_recovery)

    def settle(self) -> OptimisedState:
        """Let the propagated state take the place of the optimised one, and return it."""
        kernel.settle(self.address)
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
