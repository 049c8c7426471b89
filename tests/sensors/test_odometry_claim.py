"""What a covariance in the message of an odometry counts for: directions that it does not know, and no garbage."""

import gtsam
import numpy as np
import pytest

from holdfast.config.sensors import OdometryConfig
from holdfast.geometry.world import World
from holdfast.messages import SensorPose
from holdfast.sensors.odometry import OdometryModel
from holdfast.sensors.odometry_claim import claimed_excess

CONFIG = OdometryConfig(kind="odometry", topic="/lidar")
SMALL = np.repeat([1e-6, 1e-4], 3)


def along_x(variance=4.0):
    claim = np.diag(SMALL)
    claim[3, 3] = variance
    return claim


def test_the_direction_that_is_not_known_is_added_and_no_other():
    excess = claimed_excess(along_x(), CONFIG)
    np.testing.assert_allclose(excess, np.diag([0, 0, 0, 4.0, 0, 0]), atol=1e-9)


def test_a_claim_may_leave_position_and_heading_free_at_once():
    sigmas = np.array([1e-3, 1e-3, 0.5, 3.0, 3.0, 0.01])
    excess = claimed_excess(np.diag(sigmas**2), CONFIG)
    np.testing.assert_allclose(np.sqrt(np.diag(excess)), [0, 0, 0.5, 3.0, 3.0, 0], atol=1e-9)


@pytest.mark.parametrize(
    "claim",
    [
        None,
        np.eye(6),
        1e6 * np.eye(6),
        np.diag(np.repeat([1e-6, 25.0], 3)),  # of a pose, that grows since the start
        np.diag(SMALL),
        np.full((6, 6), np.nan),
        -np.eye(6),
        np.diag([1e-6, 1e-6, 1e-6, 4.0, 1e-4, -4.0]),
        np.triu(np.full((6, 6), 2.0)),
    ],
)
def test_claims_that_tell_no_directions_apart_add_nothing(claim):
    assert claimed_excess(claim, CONFIG) is None


def test_the_configuration_may_take_every_claim_or_none():
    always, never = (CONFIG.model_copy(update={"covariance": value}) for value in ("always", "never"))
    np.testing.assert_allclose(claimed_excess(1e-4 * np.eye(6), always), 1e-4 * np.eye(6))
    assert claimed_excess(along_x(), never) is None


def test_the_claim_is_brought_from_the_axes_of_the_message_to_the_imu():
    """The lidar looks along y of its track's frame; it claims that y: its own x, and y of the IMU."""
    T_I_L = gtsam.Pose3(gtsam.Rot3.Yaw(np.pi / 2), np.array([1.0, 0.0, 2.0]))
    model = OdometryModel("lidar", CONFIG, T_I_L)
    claim = np.diag(SMALL)
    claim[4, 4] = 4.0
    quaternion = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    pose = model.convert(SensorPose(1, 1, "lidar", np.zeros(3), quaternion, claim), World())
    np.testing.assert_allclose(pose.excess, np.diag([0, 0, 0, 0, 4.0, 0]), atol=1e-9)


def test_a_claim_is_not_larger_than_what_leaves_the_optimiser_its_digits():
    claim = np.diag(SMALL)
    claim[3, 3] = 25.0**2
    assert claimed_excess(claim, CONFIG)[3, 3] == pytest.approx(1e5 * CONFIG.translation_sigma_m**2)
