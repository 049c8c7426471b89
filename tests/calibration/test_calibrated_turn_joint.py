"""The encoder's zero and the tilts of both IMUs, from rates that are known."""

import numpy as np
import pytest

from holdfast.calibration.evidence import Evidence, Nodes, Readings, States
from holdfast.calibration.turn_joint import turn_joint
from holdfast.config.load import parse_config

CONFIG = parse_config("""
sensors:
  imu: {kind: imu, topic: /imu}
  base_imu: {kind: base_imu, topic: /base, mounting_sigma_deg: 0.03}
  joint: {kind: joint, topic: /joint, zero_offset_sigma_deg: 0.3}
  gnss: {kind: gnss, topic: /gnss}
extrinsics:
  - {parent: cabin, child: imu, translation_m: [0.2, 0.1, 0.3], rotation_rpy_deg: [0, 0, 90]}
  - {parent: cabin, child: gnss, translation_m: [0, 0, 2]}
  - {parent: base_link, child: base_imu, translation_m: [0.4, 0.2, 0.7]}
turn_joint: {parent: base_link, child: cabin, translation_m: [0, 0, 1]}
""")
RATE_HZ, END_S = 50.0, 120.0


def exp(x, y):
    """A small rotation about x and y."""
    R = np.eye(3)
    R[0, 2], R[2, 0], R[1, 2], R[2, 1] = y, -y, -x, x
    return R


def rough(*, zero=0.0, cabin=(0.0, 0.0), chassis=(0.0, 0.0), rough_rad_s=0.05, seed=0):
    """A drive over rough ground while the cabin slews; noise of a tactical gyroscope and biases."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, END_S, 1.0 / RATE_HZ)
    w = np.column_stack([np.convolve(rng.standard_normal(len(t)), np.ones(25) / 5.0, "same") for _ in range(3)])
    w = w * [rough_rad_s, rough_rad_s, 0.2]
    q = np.sin(0.3 * t)
    cos, sin = np.cos(q), np.sin(q)
    in_cabin = np.column_stack(
        [cos * w[:, 0] + sin * w[:, 1], cos * w[:, 1] - sin * w[:, 0], w[:, 2] + np.gradient(q, t)]
    )
    R_C_I = CONFIG.T("cabin", "imu")[:3, :3]
    of_imu = in_cabin @ exp(*cabin) @ R_C_I + [1e-3, -2e-3, 5e-4]
    of_base = w @ exp(*chassis) + [-1e-3, 1e-3, 0.0]
    noise = [8e-4 * rng.standard_normal((len(t), 3)) for _ in range(2)]
    stamps = np.round(t * 1e9).astype(np.int64) + 10**18
    forces = np.tile([0.0, 0.0, 9.81], (len(t), 1))
    readings = {
        "imu": Readings(stamps, np.hstack([of_imu + noise[0], forces])),
        "base_imu": Readings(stamps, np.hstack([of_base + noise[1], forces])),
        "joint": Readings(stamps, (q - zero)[:, None]),
    }
    nothing = np.zeros((0, 3))
    none = np.zeros(0, np.int64)
    return Evidence(
        "rough", CONFIG, END_S, [], {}, Nodes(none, nothing, np.zeros((0, 3, 3))),
        States(none, nothing, nothing, np.zeros(0, np.bool_)), readings, {}, {}, [], [],
    )  # fmt: skip


def test_zero_and_tilts_are_found_within_three_sigmas():
    cabin, chassis = (np.radians(0.5), np.radians(-0.4)), (np.radians(-0.3), np.radians(0.6))
    found = turn_joint([rough(zero=4e-3, cabin=cabin, chassis=chassis)], CONFIG)
    truth = [np.degrees(4e-3), 0.5, -0.4, -0.3, 0.6]
    for one, true in zip(found.estimates, truth, strict=True):
        assert abs(one.after - true) < 3.0 * one.sigma, one.what
        assert one.sigma < 0.1
    assert {change.path[-1] for change in found.changes} == {"zero_offset_deg", "rotation_rpy_deg"}


@pytest.mark.parametrize("seed", range(5))
def test_a_zero_that_is_right_stays(seed):
    found = turn_joint([rough(seed=seed)], CONFIG)
    assert not any(change.path[-1] == "zero_offset_deg" for change in found.changes)
    assert abs(found.estimates[0].after) < 3.0 * found.estimates[0].sigma


def test_on_smooth_ground_nothing_is_known_of_the_zero_and_that_is_said():
    found = turn_joint([rough(zero=4e-3, rough_rad_s=1e-5)], CONFIG)
    assert found.estimates[0].reason.startswith("not observable")
    assert not any(change.path[-1] == "zero_offset_deg" for change in found.changes)


def test_the_zero_is_known_no_better_than_the_yaw_of_the_chassis_imu():
    sensors = dict(CONFIG.sensors)
    sensors["base_imu"] = sensors["base_imu"].model_copy(update={"mounting_sigma_deg": 0.3})
    found = turn_joint([rough(zero=4e-3)], CONFIG.model_copy(update={"sensors": sensors}))
    assert found.estimates[0].sigma >= 0.3 and not found.estimates[0].is_observable


def test_a_machine_without_a_chassis_imu_has_nothing_to_compare():
    sensors = {name: one for name, one in CONFIG.sensors.items() if name != "base_imu"}
    assert turn_joint([rough()], CONFIG.model_copy(update={"sensors": sensors})).estimates == ()


def test_a_mount_that_is_turned_stays_where_it_is():
    found = turn_joint([rough(chassis=(0.01, 0.0))], CONFIG)
    assert not any(change.path == ("extrinsics", 2, "translation_m") for change in found.changes)
    assert any(change.path == ("extrinsics", 2, "rotation_rpy_deg") for change in found.changes)
