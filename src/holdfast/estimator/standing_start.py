"""A start at standstill, which is checked and not assumed: an even motion is as quiet.

Gravity gives roll and pitch, the gyroscope's mean its bias, what is felt beyond gravity the accelerometer's, and
positions the place through the lever arm (paper, IV-A.5); the heading comes from the first source that knows it.
"""

from collections.abc import Mapping

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.estimator.collected import Collected, between
from holdfast.estimator.first_heading import FirstHeading
from holdfast.estimator.known_biases import KnownBiases
from holdfast.graph.first_guess import level_attitude
from holdfast.messages import Array
from holdfast.sensors.lever_arm import is_in_doubt
from holdfast.sensors.sensor import PositionSensor
from holdfast.sensors.standstill import fixes_stand, standstill_covariance, velocities_stand
from holdfast.state import OptimisedState

STANDING_S = 5.0, 15.0  # over which positions tell whether the machine stands, longer ones if the first cannot
NO_HEADING = "standing still without a heading: give initialisation.heading_deg, a heading topic, or move"
OF_W_RAD = 1e-3  # sigma of a heading that is zero by definition


class StandingStart:
    """Looks for a state at standstill in what was collected.

    Args:
        config: of the estimator.
        collected: what was measured of late.
        gravity: [m/s^2].
        points: where positions are of, by name of their sensor, in the order of their worth.
        heading: the sources of the heading.
        biases: what is known of them; it is told what standstill tells.
    """

    def __init__(
        self,
        config: Config,
        collected: Collected,
        gravity: float,
        *,
        points: Mapping[str, PositionSensor],
        heading: FirstHeading,
        biases: KnownBiases,
    ) -> None:
        self._imu, self._standstill_s = config.imu, config.initialisation.standstill_s
        self._points, self._heading, self._collected = points, heading, collected
        self._biases, self._gravity = biases, gravity

    def is_standing(self, now_ns: int) -> bool:
        """Whether positions and velocities, if positions are configured, agree that the machine stands."""
        return not self._points or bool(self.stands(now_ns, self._standstill_s))

    def stands(self, end_ns: int, duration_s: float) -> bool | None:
        """Whether velocities and positions say that the machine stood for so long; None while they cannot tell."""
        since_ns = end_ns - round(duration_s * 1e9)
        by_velocity = velocities_stand(between(self._collected.velocities, since_ns, end_ns))
        by_position = None
        for longer_s in STANDING_S:
            longer_ns = end_ns - round(max(longer_s, 2.0 * duration_s) * 1e9)
            if by_position is None:
                fixes = self._collected.of_first_receiver(longer_ns)
                by_position = fixes_stand([one for one in fixes if one.stamp_ns <= end_ns])
        if by_velocity is None or by_position is None:
            return by_velocity if by_position is None else by_position
        return by_velocity and by_position

    def attempt(self, now_ns: int, force: Array, rate: Array) -> OptimisedState | str:
        """Return the state of a machine that stands, or what is missing.

        Args:
            now_ns: when.
            force: (3,) mean specific force of late, in I [m/s^2].
            rate: (3,) mean angular velocity [rad/s].
        """
        level, felt = level_attitude(force), float(np.linalg.norm(force))
        up = force / felt
        bias = gtsam.imuBias.ConstantBias((felt - self._gravity) * up, rate)
        self._biases.note_standstill(bias)
        heading = self._heading.at_standstill(now_ns, level)
        if heading is None and not self._points:
            heading = 0.0, OF_W_RAD  # W is where the machine starts
        if heading is None or isinstance(heading, str):
            return heading or NO_HEADING
        yaw, yaw_sigma = heading
        R_W_I = gtsam.Rot3.Yaw(yaw).compose(level)
        position, in_W, arm = self._position(now_ns, R_W_I)
        in_imu = R_W_I.matrix().T @ in_W @ R_W_I.matrix()
        covariance = standstill_covariance(self._imu, self._standstill_s, self._gravity, up, yaw_sigma, in_imu, arm)
        return OptimisedState(now_ns, gtsam.NavState(R_W_I, position, np.zeros(3)), bias, covariance, np.zeros(3))

    def _position(self, now_ns: int, R_W_I: gtsam.Rot3) -> tuple[Array, Array, Array]:
        """Return p_W_I, its covariance in W, and the lever arm through which it was found."""
        since_ns = now_ns - round(self._standstill_s * 1e9)
        fixes = self._collected.of_first_receiver(since_ns) or self._collected.of_first_receiver()[-1:]
        if not fixes:
            return np.zeros(3), np.eye(3) * 1e-4, np.zeros(3)
        sensor = self._points[fixes[-1].sensor]
        arm: Array = sensor.p_I_P
        mean: Array = np.mean([one.p_W_P for one in fixes], axis=0)
        position: Array = mean - R_W_I.rotate(arm)
        of_arm = sensor.parameters[0].sigmas if is_in_doubt(sensor.parameters) else np.zeros(3)
        return position, fixes[-1].covariance + np.diag(of_arm**2), arm
