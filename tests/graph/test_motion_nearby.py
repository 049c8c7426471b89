"""The motion of a machine about a node, as its IMU measured it."""

import gtsam
import numpy as np
import pytest
from motion import Drive, G, imu, machine, ns

from holdfast.graph.motion_nearby import LEAST_S, SHAKEN_S, MotionNearby
from holdfast.sensors.imu import ImuBuffer

DRIVE = Drive(speed=1.5)
AT_S = 6.0
BIAS = np.array([0.05, -0.03, 0.02, 0.004, -0.002, 0.003])


def motion_nearby(until_s=7.0, **how):
    buffer = ImuBuffer(machine().imu)
    for sample in imu(DRIVE, 0.0, until_s, 400.0, bias=BIAS, **how):
        buffer.add(sample)
    bias = gtsam.imuBias.ConstantBias(BIAS[:3], BIAS[3:])
    return MotionNearby(buffer, ns(AT_S), DRIVE.nav(AT_S), DRIVE.readings(AT_S)[1], bias=bias, gravity=G)


@pytest.mark.parametrize("duration_s", [0.06, -0.06, 0.013, -0.2])
def test_it_leads_to_where_the_machine_was(duration_s):
    here, there = DRIVE.nav(AT_S), DRIVE.pose(AT_S + duration_s)
    twist = np.concatenate([DRIVE.readings(AT_S)[1], here.bodyVelocity()])
    beyond = motion_nearby().twist_beyond(duration_s)
    np.testing.assert_allclose(twist + beyond, gtsam.Pose3.Logmap(here.pose().between(there)) / duration_s, atol=1e-4)
    assert np.linalg.norm(beyond) > 0.3 * abs(duration_s)  # it is not that of the node


def test_at_nearly_the_same_times_it_is_the_same():
    beyond = motion_nearby().twist_beyond
    assert beyond(0.05) is beyond(0.0504) is not beyond(0.06)
    assert not motion_nearby().twist_beyond(0.5 * LEAST_S).any()


def test_where_the_imu_did_not_measure_it_is_that_of_the_node():
    assert not motion_nearby(until_s=AT_S).twist_beyond(0.05).any()  # not yet
    assert not motion_nearby().twist_beyond(-30.0).any()  # not any more
    assert not motion_nearby().acceleration(-30.0).any()


@pytest.mark.parametrize("duration_s", [0.15, -0.15, 0.4, -0.4])
def test_the_acceleration_leads_to_the_velocity_there(duration_s):
    here, there = DRIVE.nav(AT_S), DRIVE.nav(AT_S + duration_s)
    gained = here.attitude().unrotate(there.velocity() - here.velocity())
    np.testing.assert_allclose(motion_nearby().acceleration(duration_s), gained / duration_s, atol=2e-3)


@pytest.mark.parametrize("duration_s", [0.0, 0.05, -0.05])
def test_over_a_short_time_it_is_that_of_the_last_tenth_of_a_second(duration_s):
    near = motion_nearby()
    np.testing.assert_array_equal(near.acceleration(duration_s), near.acceleration(-SHAKEN_S))
    assert near.acceleration(duration_s).any()
