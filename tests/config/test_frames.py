"""Frames of a configuration that contradict each other are refused, each in a line."""

import pytest
from test_load import FULL, MINIMAL, faults

from holdfast.config.load import parse_config


def test_two_antennas_in_one_frame_are_refused() -> None:
    antennas = "  left: {kind: gnss, topic: /g, frame: mast}\n  right: {kind: gnss, topic: /r, frame: mast}\n"
    (found,) = faults(MINIMAL + antennas + "extrinsics: [{parent: imu, child: mast}]\n")
    assert found == "f.yaml:6 sensors.right.frame: is that of left: two antennas cannot share one frame"


def test_a_baseline_from_an_antenna_to_itself_is_refused() -> None:
    text = FULL.replace("topic: /heading}", "topic: /heading, baseline: [gnss, gnss]}")
    assert faults(text) == ["f.yaml:6 sensors.heading.baseline: must be two antennas, not gnss twice"]
    parse_config(text.replace("[gnss, gnss]", "[gnss, gnss_right]"))


@pytest.mark.parametrize(
    ("frames", "fault"),
    [
        ("world: map, odometry: map", "odometry: 'map' is frames.world, too: must be another name"),
        ("world: odom", "odometry: 'odom' is frames.world, too: must be another name"),
        ("world: imu", "world: 'imu' is a frame of the machine: must be another name"),
        ("odometry: mast", "odometry: 'mast' is a frame of the machine: must be another name"),
        ("odometry: base_link", "odometry: 'base_link' is a frame of the machine: must be another name"),
        ("base: map", "world: 'map' is a frame of the machine: must be another name"),
        ("world: ''", "world: must not be empty"),
        ("base: ' '", "base: must not be empty"),
    ],
)
def test_published_frames_that_would_be_no_tree_are_refused(frames: str, fault: str) -> None:
    text = MINIMAL + "extrinsics: [{parent: imu, child: mast}]\n"
    assert faults(f"{text}frames: {{{frames}}}\n") == [f"f.yaml:6 frames.{fault}"]


def test_the_base_may_be_the_frame_of_the_imu() -> None:
    assert not parse_config(f"{MINIMAL}frames: {{base: imu}}\n").has_base()


def test_every_frame_that_cannot_be_reached_is_said_on_its_own_line() -> None:
    found = faults(MINIMAL + "  gnss: {kind: gnss, topic: /g}\n  lidar: {kind: odometry, topic: /l}\n")
    assert [line.split(": ")[0].split()[-1] for line in found] == ["sensors.gnss.frame", "sensors.lidar.frame"]
    assert all("no transforms lead from 'imu'" in line for line in found)


@pytest.mark.parametrize(
    ("pairs", "told"),
    [
        ([("a", "b"), ("b", "c"), ("c", "a")], "b -> c -> a -> b"),
        ([("a", "a")], "a -> a"),
        ([("a", "b"), ("b", "a"), ("b", "c")], "b -> a -> b"),
        ([("imu", "d"), ("d", "imu")], "d -> imu -> d"),
    ],
)
def test_frames_that_carry_themselves_are_refused(pairs: list[tuple[str, str]], told: str) -> None:
    """Also where no sensor sits on them."""
    links = "".join(f"- {{parent: {parent}, child: {child}}}\n" for parent, child in pairs)
    (fault,) = faults(f"{MINIMAL}extrinsics:\n{links}")
    assert f"extrinsics: {told} lead back to where they begin" in fault
