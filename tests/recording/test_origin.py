"""A simulated recording tells its seed, wherever it is moved; nothing else claims to have one."""

import pytest
from click.testing import CliRunner

from holdfast.cli import holdfast
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.origin import read_origin
from holdfast.recording.source import open_recording


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("origin") / "yard"
    made = CliRunner().invoke(holdfast, ["simulate", "quick", "-o", str(folder), "--seed", "41", "--duration", "2"])
    assert made.exit_code == 0, made.output
    return folder


def test_a_simulated_recording_tells_its_seed_as_folder_and_as_file(simulated, tmp_path):
    moved = tmp_path / "elsewhere.mcap"
    moved.write_bytes((simulated / "recording.mcap").read_bytes())
    for path in (simulated, simulated / "recording.mcap", str(moved)):
        assert read_origin(path)["seed"] == "41"


def test_what_is_noted_is_no_topic(simulated):
    with open_recording(simulated) as recording:
        assert "holdfast.simulation" not in {info.topic for info in recording.topics}
        assert sum(info.count for info in recording.topics) == sum(1 for _ in recording.read_headers())


def test_nothing_is_known_of_other_recordings_and_of_those_cut_off(simulated, tmp_path):
    with McapWriter(tmp_path / "other.mcap") as writer:
        message = writer.types["std_msgs/msg/String"](data="here")
        writer.write("/said", message, "std_msgs/msg/String", 1)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((simulated / "recording.mcap").read_bytes()[:-1000])
    for path in (tmp_path / "other.mcap", cut, tmp_path / "none.mcap", tmp_path / "a.bag", "kitti"):
        assert read_origin(path) == {}
