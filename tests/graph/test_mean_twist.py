"""The mean twist of a machine about a node, as its IMU measured it."""

import gtsam
import numpy as np
import pytest
from motion import Drive, G, imu, machine, ns

from holdfast.graph.mean_twist import LEAST_S, MeanTwist
from holdfast.sensors.imu import ImuBuffer

DRIVE = Drive(speed=1.5)
AT_S = 6.0
BIAS = np.array([0.05, -0.03, 0.02, 0.004, -0.002, 0.003])


def mean_twist(until_s=7.0, **how):
    buffer = ImuBuffer(machine().imu)
    for sample in imu(DRIVE, 0.0, until_s, 400.0, bias=BIAS, **how):
        buffer.add(sample)
    bias = gtsam.imuBias.ConstantBias(BIAS[:3], BIAS[3:])
    return MeanTwist(buffer, ns(AT_S), DRIVE.nav(AT_S), DRIVE.readings(AT_S)[1], bias=bias, gravity=G)


@pytest.mark.parametrize("duration_s", [0.06, -0.06, 0.013, -0.2])
def test_it_leads_to_where_the_machine_was(duration_s):
    here, there = DRIVE.nav(AT_S), DRIVE.pose(AT_S + duration_s)
    twist = np.concatenate([DRIVE.readings(AT_S)[1], here.bodyVelocity()])
    beyond = mean_twist()(duration_s)
    np.testing.assert_allclose(twist + beyond, gtsam.Pose3.Logmap(here.pose().between(there)) / duration_s, atol=1e-4)
    assert np.linalg.norm(beyond) > 0.3 * abs(duration_s)  # it is not that of the node


def test_at_nearly_the_same_times_it_is_the_same():
    beyond = mean_twist()
    assert beyond(0.05) is beyond(0.0504) is not beyond(0.06)
    assert not mean_twist()(0.5 * LEAST_S).any()


def test_where_the_imu_did_not_measure_it_is_that_of_the_node():
    assert not mean_twist(until_s=AT_S)(0.05).any()  # not yet
    assert not mean_twist()(-30.0).any()  # not any more
