"""The first state: what a start can be attempted with, what is missing, and where W is without GNSS."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, G, at, fixes, imu, machine, ns, poses
from rig import position

from holdfast.estimator.initialisation import Initialising
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.odometry import TrackPose
from holdfast.sensors.registry import sensors_of

STILL = Drive(start_s=100.0)
MARKER = {"marker": {"kind": "pose", "mount": at([0.0, 0.0, 0.0])}}


def begun(until_s=2.0, motion=STILL, **config):
    config = machine(**config)
    buffer = ImuBuffer(config.imu)
    for sample in imu(motion, 0.0, until_s, 100.0, np.random.default_rng(1)):
        buffer.add(sample)
    return Initialising(config, buffer, sensors_of(config), G), sensors_of(config)


def stand(initialiser, start_s=0.5, end_s=2.0):
    for t in np.arange(start_s, end_s, 0.1):
        initialiser.add(position(STILL, t, ARM))


def test_positions_are_what_a_start_is_attempted_with():
    initialiser, _ = begun()
    assert initialiser.add(position(STILL, 1.0, ARM))
    assert not initialiser.add(TrackPose(ns(1.0), "lidar", gtsam.Pose3()))


def test_without_positions_an_odometry_will_do():
    initialiser, _ = begun(gnss=False)
    assert initialiser.add(TrackPose(ns(1.0), "lidar", gtsam.Pose3()))


def waiting_for(until_s, sensors):
    config = machine(gnss=False)
    config = config.model_copy(update={"sensors": {name: config.sensors[name] for name in sensors}})
    buffer = ImuBuffer(config.imu)
    for sample in imu(STILL, 0.0, until_s, 100.0, np.random.default_rng(1)):
        buffer.add(sample)
    return Initialising(config, buffer, sensors_of(config), G).waiting_for


def test_an_imu_that_has_come_is_not_what_is_waited_for():
    """An IMU alone said "no usable IMU sample has come", after 500 of them."""
    lidar = "no usable measurement of a sensor other than the IMU has come"
    assert waiting_for(2.0, ["imu", "lidar"]) == lidar
    assert waiting_for(-1.0, ["imu", "lidar"]) == f"no usable IMU sample has come, and {lidar}"
    assert waiting_for(2.0, ["imu"]).startswith("no sensor beside the IMU is configured that can start it (needed: pos")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("variance", "claim"), [(4.0, ", it claims 2 m"), (-1.0, ""), (np.nan, "")])
def test_a_fix_that_was_refused_is_told_with_its_claim_if_that_is_one(variance, claim):
    initialiser, _ = begun()
    (fix,) = fixes(STILL, 1.0, 1.05, 10.0, np.random.default_rng(1))
    initialiser.refuse(replace(fix, covariance=np.eye(3) * variance), Outcome.LARGE_COVARIANCE)
    assert initialiser.waiting_for.endswith(f"the last of gnss was refused: large_covariance{claim}")


def test_at_standstill_the_state_is_that_of_gravity_the_heading_and_the_lever_arm():
    initialiser, _ = begun()
    stand(initialiser)
    state = initialiser.attempt()
    assert initialiser.reason == "standstill"
    error = state.nav.localCoordinates(STILL.nav(0.0))
    assert (abs(error) < 4.0 * np.sqrt(np.diag(state.covariance)[:9])).all()
    assert not state.nav.velocity().any() and not state.angular_velocity.any()


@pytest.mark.parametrize(
    ("until_s", "fixes_until_s", "reason"),
    [
        (0.5, 2.0, "the IMU has not measured without a gap for 1 s"),
        (2.0, 0.55, "1 usable positions since the IMU measures without a gap; 3 are needed"),
        (2.0, 8.05, "others have measured 6.0 s later than the IMU: it is silent, or a clock is wrong"),
    ],
)
def test_what_is_missing_is_said(until_s, fixes_until_s, reason):
    initialiser, _ = begun(until_s)
    stand(initialiser, end_s=fixes_until_s)
    assert initialiser.attempt() is None
    assert initialiser.reason == reason


def test_an_absolute_pose_gives_heading_and_position_where_w_is_that_of_the_pose():
    initialiser, sensors = begun(gnss=False, lidar=False, heading_deg=None, more=MARKER)
    for message in poses(STILL, 0.5, 1.9):
        assert initialiser.add(sensors["marker"].convert(message, World()))
    state = initialiser.attempt()
    assert state.nav.pose().translation() == pytest.approx(STILL.pose(0.0).translation(), abs=0.01)
    assert state.nav.attitude().rpy()[2] == pytest.approx(STILL.nav(0.0).attitude().rpy()[2], abs=0.02)


def test_a_pose_whose_frame_is_offset_by_an_unknown_constant_tells_nothing_of_w():
    marker = {"marker": MARKER["marker"] | {"offset_sigma_m": 10.0, "offset_sigma_deg": 10.0}}
    initialiser, sensors = begun(lidar=False, heading_deg=None, more=marker)
    stand(initialiser)
    for message in poses(STILL, 0.5, 1.9):
        initialiser.add(sensors["marker"].convert(message, World()))
    assert initialiser.attempt() is None
    assert "standing still without a heading" in initialiser.reason
