"""What was learnt at the turn joint: in its file, and as the values that the configuration should have."""

import json
import sys
from pathlib import Path

import gtsam
import numpy as np
import pytest
import yaml

sys.path.append(str(Path(__file__).parents[1] / "chassis"))

from slewing import machine

from holdfast.calibration.learnt_file import load_learnt, save_learnt
from holdfast.calibration.learnt_table import learnt_rows, wrong_lines
from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.sensors.constants import LearntConstant
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT, LearntJoint

TILT = np.radians([2.0, -1.5])
KNOWN = LearntSnapshot(
    joint=LearntJoint(
        zero=LearntConstant(mean=(np.radians(2.0),), sigmas=(1e-3,)),
        cabin_tilt=LearntConstant(mean=(1e-3, -1e-3), sigmas=(1e-3, 1e-3)),
        base_tilt=LearntConstant(mean=tuple(TILT), sigmas=(1e-3, 1e-3)),
    )
)


@pytest.fixture
def file(tmp_path):
    found = tmp_path / "learnt.json"
    save_learnt(found, KNOWN, machine())
    return found


def changed(**sections):
    data = machine().model_dump(exclude_unset=True)
    for name, section in sections.items():
        if name in data["sensors"]:
            data["sensors"][name] |= section
    return data


def test_it_comes_back_as_it_was(file):
    assert load_learnt(file, machine()) == (KNOWN, [])


def test_a_file_from_before_there_was_such_a_thing_holds_nothing_of_it(file):
    data = json.loads(file.read_text())
    del data["learnt"]["joint"], data["configured"]["joint"], data["configured"]["base_imu"]
    file.write_text(json.dumps(data))
    assert load_learnt(file, machine()) == (NOTHING_LEARNT, [])


@pytest.mark.parametrize(
    ("name", "mean", "sigma", "words"),
    [
        ("base_tilt", [0.1], 0.1, "base_tilt: must have 2 numbers in mean"),
        ("zero", [0.1], 1e200, r"zero: must be within \+-6\.28 rad"),
        ("zero", [114.0], 0.1, r"zero: must be within \+-6\.28 rad"),
    ],
)
def test_what_is_no_angle_is_one_line(file, name, mean, sigma, words):
    data = json.loads(file.read_text())
    data["learnt"]["joint"][name] = {"mean": mean, "sigmas": [sigma]}
    file.write_text(json.dumps(data))
    with pytest.raises(ConfigError, match=words):
        load_learnt(file, machine())


@pytest.mark.parametrize(
    ("sections", "key"),
    [
        ({"joint": {"zero_offset_deg": 2.0}}, "zero_offset_deg 0.0 -> 2.0"),
        ({"joint": {"zero_offset_sigma_deg": 5.0}}, "zero_offset_sigma_deg"),
        ({"base_imu": {"mounting_sigma_deg": 1.0}}, "mounting_sigma_deg"),
        ({"joint": {"noise_deg": 0.1}, "base_imu": {"gyroscope_noise_density": 1e-3}}, ""),
    ],
)
def test_a_key_that_has_changed_since_is_the_firmer_word(file, sections, key):
    learnt, warnings = load_learnt(file, Config.model_validate(changed(**sections)))
    assert learnt.joint == (NOTHING_OF_JOINT if key else KNOWN.joint)
    assert len(warnings) == bool(key) and key in "".join(warnings)


@pytest.mark.parametrize("which", ["base_imu", "imu", "turn_joint"])
def test_a_unit_or_a_joint_that_sits_otherwise_in_the_file_is_learnt_anew(file, which):
    data = changed()
    links = [data["turn_joint"], *data["extrinsics"]]
    link = next(one for one in links if one["child"] == {"turn_joint": "cabin"}.get(which, which))
    turned = gtsam.Rot3.Rz(0.01).matrix() @ np.array(link["rotation_matrix"])
    link["rotation_matrix"] = tuple(map(tuple, turned.tolist()))
    learnt, warnings = load_learnt(file, Config.model_validate(data))
    assert learnt.joint == NOTHING_OF_JOINT and all("of its frame" in one for one in warnings) and warnings


def test_without_the_base_imu_it_is_ignored_with_a_warning(file):
    learnt, warnings = load_learnt(file, machine(base_imu=False))
    assert learnt.joint == NOTHING_OF_JOINT
    assert warnings == ["base_imu: is not configured: what was learnt of it is ignored"]


# --- what is told -----------------------------------------------------------------------------------------------------


def by_what(learnt=KNOWN, **sections):
    rows = learnt_rows(learnt, Config.model_validate(changed(**sections)))
    return {(row.sensor, row.what): row for row in rows}


def test_the_zero_is_told_with_the_value_to_write():
    row = by_what(base_imu={"mounting_sigma_deg": 0.3}, joint={"zero_offset_deg": 10.0})["joint", "zero"]
    assert (row.key, row.configured, row.write) == ("sensors.joint.zero_offset_deg", 10.0, "12.000")
    assert row.looks_wrong and row.sigma == pytest.approx(np.hypot(0.3, np.degrees(1e-3)))
    lines = wrong_lines(learnt_rows(KNOWN, machine()))
    assert lines[0] == "sensors.joint.zero_offset_deg looks wrong (joint, zero): 2.000, is 0"


def test_what_is_to_be_written_is_within_the_bounds_of_the_key():
    row = by_what(joint={"zero_offset_deg": 359.0})["joint", "zero"]
    assert float(row.write) == pytest.approx(1.0)


def test_a_zero_that_the_yaw_of_the_base_imu_explains_is_not_told_to_be_wrong():
    assert not by_what(base_imu={"mounting_sigma_deg": 1.0})["joint", "zero"].looks_wrong


def test_a_tilt_of_the_base_imu_is_told_with_the_rotation_to_write():
    rows = by_what()
    about_x, about_y = (rows["base_imu", f"mounting, about the joint's {axis}"] for axis in "xy")
    assert (about_x.learnt, about_y.learnt) == pytest.approx((2.0, -1.5)) and about_x.looks_wrong
    assert about_x.key == "extrinsics[2].rotation_matrix"
    config = machine()
    T_P_S = config.T(config.turn_joint.parent, config.frame_of("base_imu"))
    data = changed()
    data["extrinsics"][2]["rotation_matrix"] = yaml.safe_load(about_x.write)
    written = Config.model_validate(data)
    R_P_S = written.T(written.turn_joint.parent, written.frame_of("base_imu"))[:3, :3]
    tilted = gtsam.Rot3.Expmap(np.array([*TILT, 0.0])).matrix() @ T_P_S[:3, :3]
    assert pytest.approx(tilted, abs=1e-6) == R_P_S
    assert not rows["imu", "mounting, about the joint's x"].looks_wrong


def test_a_machine_without_a_joint_has_no_such_rows():
    config = machine(base_imu=False)
    assert learnt_rows(KNOWN, config) == []
