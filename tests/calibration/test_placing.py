"""A frame is moved in `extrinsics` in the form in which it is written there."""

import gtsam
import numpy as np
import pytest

from holdfast.calibration.placing import moved
from holdfast.config.load import config_of

TURN = np.eye(4)
TURN[:3, :3] = gtsam.Rot3.Expmap(np.array([0.01, -0.02, 0.03])).matrix()
SHIFT = np.eye(4)
SHIFT[:3, 3] = [0.01, 0.02, -0.03]


def config_with(*extrinsics):
    sensors = {"imu": {"kind": "imu", "topic": "/i"}, "lidar": {"kind": "odometry", "topic": "/l"}}
    return config_of({"sensors": sensors, "extrinsics": list(extrinsics)}, "config")


ENTRIES = (
    {"parent": "imu", "child": "lidar", "translation_m": [1.0, 2.0, 3.0], "rotation_rpy_deg": [10.0, -20.0, 30.0]},
    {"parent": "imu", "child": "lidar", "rotation_quaternion_xyzw": [0.5, 0.5, 0.5, 0.5]},
    {"parent": "imu", "child": "lidar", "rotation_matrix": [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]},
    {"parent": "imu", "child": "lidar", "translation_m": [1.0, 2.0, 3.0]},
    {"parent": "lidar", "child": "imu", "translation_m": [1.0, 2.0, 3.0], "rotation_rpy_deg": [10.0, -20.0, 30.0]},
)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: "-".join(entry)[:40])
@pytest.mark.parametrize("correction", [TURN, SHIFT], ids=["turn", "shift"])
def test_the_pose_of_the_frame_is_the_old_one_times_the_correction(entry, correction):
    config = config_with(entry)
    changes = moved(config, "lidar", correction)
    now = config_with(entry | {change.path[-1]: change.value for change in changes})
    assert np.allclose(now.T_I("lidar"), config.T_I("lidar") @ correction, atol=1e-4)
    rotations = {key for key in entry if key.startswith("rotation")} or {"rotation_rpy_deg"}
    assert {change.path[-1] for change in changes} <= rotations | {"translation_m"}


def test_a_frame_that_carries_others_is_not_moved_behind_their_back():
    on_it = {"parent": "lidar", "child": "camera"}
    assert "must be in one entry" in moved(config_with(ENTRIES[0], on_it), "lidar", TURN)
