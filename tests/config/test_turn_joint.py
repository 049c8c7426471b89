"""The chassis in the configuration: frames must be joined on both sides of the turn joint; faults say which is not."""

import re

import numpy as np
import pytest

from holdfast.config.load import parse_config, resolved_yaml
from holdfast.config.proposal import propose
from holdfast.config.review import sensor_rows, warnings
from holdfast.config.starter import starter_yaml
from holdfast.errors import ConfigError
from holdfast.recording.decode import IMU
from holdfast.recording.kinds import KINDS
from holdfast.recording.kinds.joint import JOINT_STATE
from holdfast.recording.source import TopicInfo

MACHINE = """\
sensors:
  imu: {kind: imu, topic: /imu}
  joint: {kind: joint, topic: /joint}
  base_imu: {kind: base_imu, topic: /base_imu}
extrinsics:
  - {parent: cabin, child: imu, translation_m: [0.25, -0.35, 0.12]}
  - {parent: base_link, child: base_imu, translation_m: [0, 0, 1], rotation_rpy_deg: [0, 0, 90]}
  - {parent: base_link, child: ring, translation_m: [0, 0.5, 0]}
turn_joint: {child: cabin, translation_m: [0.1, 0, 1.15]}
"""
JOINT = "turn_joint: {child: cabin, translation_m: [0.1, 0, 1.15]}"


def faults(old: str, new: str) -> list[str]:
    assert old in MACHINE
    with pytest.raises(ConfigError) as caught:
        parse_config(MACHINE.replace(old, new), "f.yaml")
    return str(caught.value).splitlines()


def test_a_machine_with_a_turn_joint_has_its_chassis_beyond_it() -> None:
    config = parse_config(MACHINE)
    assert config.has_base()
    assert not config.reaches("base_link")
    assert config.reaches("base_imu", "base_link")
    assert config.base_imu is not None
    assert (config.imu_frame, config.frame_of(config.base_imu[0])) == ("imu", "base_imu")
    assert config.turn_joint is not None
    assert (config.turn_joint.parent, config.turn_joint.child) == ("base_link", "cabin")
    np.testing.assert_array_equal(config.turn_joint.matrix()[:3, 3], [0.1, 0.0, 1.15])
    # from the base IMU, turned by 90 deg and a metre up, the ring is half a metre to its right and a metre down
    np.testing.assert_allclose(config.T("base_imu", "ring")[:3, 3], [0.5, 0.0, -1.0], atol=1e-15)
    with pytest.raises(ValueError, match="no transforms lead from 'imu' to 'ring'"):
        config.T_I("ring")


def test_it_reads_back_from_its_resolved_file() -> None:
    config = parse_config(MACHINE)
    assert parse_config(resolved_yaml(config)) == config


def test_a_rigid_chassis_needs_no_turn_joint() -> None:
    rigid = MACHINE.replace(JOINT, "").replace(
        "  - {parent: cabin", "  - {parent: base_link, child: cabin}\n  - {parent: cabin"
    )
    assert parse_config(rigid).has_base()
    assert not parse_config("sensors:\n  imu: {kind: imu, topic: /imu}\n").has_base()
    assert not parse_config("sensors:\n  imu: {kind: imu, topic: /imu, frame: base_link}\n").has_base()


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (
            "  joint: {kind: joint, topic: /joint}\n",
            "",
            "f.yaml:8 turn_joint: needs a sensor with `kind: joint`, the encoder that reads its angle",
        ),
        (
            "child: cabin, translation_m: [0.1",
            "child: cab, translation_m: [0.1",
            "f.yaml:9 turn_joint.child: no transforms lead from 'imu' to 'cab' "
            "(frames in extrinsics: base_imu, base_link, cabin, imu, ring)",
        ),
        (
            "{child: cabin, t",
            "{parent: chassis, child: cabin, t",
            "f.yaml:9 turn_joint.parent: no transforms lead from 'base_link' to 'chassis' "
            "(frames in extrinsics: base_imu, base_link, cabin, imu, ring)",
        ),
        (
            "parent: base_link, child: base_imu",
            "parent: ground, child: base_imu",
            "f.yaml:4 sensors.base_imu.frame: no transforms lead from 'base_link' to 'base_imu' "
            "(frames in extrinsics: base_imu, base_link, cabin, ground, imu, ring)",
        ),
        (
            "extrinsics:\n",
            "extrinsics:\n  - {parent: base_link, child: cabin}\n",
            "f.yaml:10 turn_joint: extrinsics join 'imu' and 'base_link' already, as if nothing turned",
        ),
        (
            "1.15]}",
            "1.15], rotation_rpy_deg: [0, 0, 1], rotation_quaternion_xyzw: [0, 0, 0, 1]}",
            "f.yaml:9 turn_joint: give only one of rotation_quaternion_xyzw, rotation_matrix, rotation_rpy_deg",
        ),
        (
            "kind: joint, topic: /joint}",
            "kind: joint, topic: /joint, max_age_s: 0}",
            "f.yaml:3 sensors.joint.max_age_s = 0: must be > 0 [s]",
        ),
    ],
)
def test_what_is_not_joined_is_named_with_line_and_place(old: str, new: str, fault: str) -> None:
    assert faults(old, new) == [fault]


def test_the_parent_may_be_any_frame_of_the_chassis() -> None:
    config = parse_config(MACHINE.replace("{child: cabin, t", "{parent: ring, child: cabin, t"))
    assert config.turn_joint is not None
    assert config.turn_joint.parent == "ring"


def test_sensors_that_only_a_turn_joint_needs_are_said_without_one() -> None:
    assert warnings(parse_config(MACHINE)) == []
    assert warnings(parse_config(MACHINE.replace(JOINT, ""))) == [
        "sensors.joint: is not used, because there is no turn_joint",
        "sensors.base_imu: is not used, because there is no turn_joint",
    ]


def test_what_turns_against_the_imu_has_no_lever_arm() -> None:
    rows = {row.sensor: row for row in sensor_rows(parse_config(MACHINE))}
    assert (rows["base_imu"].frame, rows["base_imu"].lever_arm_m) == ("base_imu", None)
    assert rows["imu"].lever_arm_m == 0.0


def test_a_starter_proposes_the_turn_joint_with_the_encoder_and_shows_how_to_write_it_without() -> None:
    imu, joint = TopicInfo("/imu", IMU, 9), TopicInfo("/joint_states", JOINT_STATE, 9)
    config = parse_config(starter_yaml(propose("x.bag", [imu, joint], KINDS.values())))
    assert config.turn_joint is not None
    assert (config.turn_joint.parent, config.turn_joint.child) == ("base_link", "cabin")
    text = starter_yaml(propose("x.bag", [imu], KINDS.values()))
    assert parse_config(text).turn_joint is None
    assert re.search(r"^# turn_joint:.*\n#   parent: base_link", text, re.MULTILINE)
