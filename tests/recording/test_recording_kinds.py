"""A kind of measurement is one row: one that only this file knows is configured, proposed, read and received live."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal, Self

import numpy as np
import pytest
from bags import HUMBLE, START_NS, imu, point, write_bag
from numpy.typing import NDArray

from holdfast.config.assignment import Measured, Rule
from holdfast.config.kinds import KINDS as SECTIONS
from holdfast.config.load import parse_config
from holdfast.config.model import Config, register_kind
from holdfast.config.proposal import propose
from holdfast.config.section import Topic
from holdfast.config.sensors import MountedConfig
from holdfast.config.starter import starter_yaml
from holdfast.errors import ConfigError, RecordingError
from holdfast.recording.columns import Columns
from holdfast.recording.decode import POINT, Decoder, stamp_ns
from holdfast.recording.inspection import inspect
from holdfast.recording.kinds import KINDS, Kind, default_decoder, register
from holdfast.recording.problems import list_problems
from holdfast.recording.source import Subscription, open_recording
from holdfast.recording.subscriptions import subscriptions


class SonarConfig(MountedConfig):
    """Range to the ground."""

    kind: Literal["sonar"]
    topic: Topic


@dataclass(frozen=True)
class Range:
    stamp_ns: int
    arrival_ns: int
    sensor: str
    range_m: float
    WIDTH: ClassVar[int] = 1

    def values(self) -> tuple[float, ...]:
        return (self.range_m,)

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        return cls(stamp_ns, arrival_ns, sensor, *values)


def sonar_decoder(subscription: Subscription) -> Decoder:
    return lambda message, arrival_ns: Range(stamp_ns(message), arrival_ns, subscription.sensor, message.point.z)


SONAR = Kind(
    "sonar",
    Range,
    {POINT: sonar_decoder},
    Columns(("range_m",), lambda stamp, arrival, sensor, v: Range(stamp, arrival, sensor, v[0])),
    (Rule("sonar", ("sonar",), named=True),),
    "the ground is unknown meanwhile",
)
PAGE = Path(__file__).parents[2] / "docs" / "recordings.md"
TEXT = """\
sensors:
  imu: {kind: imu, topic: /imu}
  depth: {kind: sonar, topic: /sonar, frame: imu}
"""
RANGE = Range(START_NS, START_NS, "depth", 4.5)


@pytest.fixture
def sonar() -> Iterator[None]:
    register_kind(SonarConfig)
    register(SONAR)
    yield
    del KINDS["sonar"], SECTIONS["sonar"]
    Config.model_rebuild(force=True)


class FakeNetwork:
    def __init__(self) -> None:
        self.subscribed: list[tuple[str, str]] = []

    def subscribe(self, topic: str, type_name: str, **_: bool) -> None:
        self.subscribed.append((topic, type_name))


def test_every_kind_of_the_configuration_that_has_a_topic_has_a_row() -> None:
    assert set(KINDS) == set(SECTIONS) - {"nonholonomic"}


def test_every_row_has_decoders_columns_and_a_rule() -> None:
    for kind in KINDS.values():
        has_columns = kind.columns is not None or kind.name == "scans"  # nobody writes clouds as CSV
        assert kind.types and has_columns and kind.rules, kind.name
        assert kind.csv_type in kind.types


def test_a_topic_without_a_configuration_is_the_first_kind_of_its_type_but_joints_are_not_guessed() -> None:
    decoder = default_decoder("/imu", "sensor_msgs/msg/Imu")
    assert decoder is not None
    assert type(decoder(imu(HUMBLE, START_NS), 0)) is KINDS["imu"].message
    assert default_decoder("/joints", "sensor_msgs/msg/JointState") is None
    assert default_decoder("/text", "std_msgs/msg/String") is None


def test_a_kind_is_unknown_before_it_is_registered() -> None:
    with pytest.raises(ConfigError, match='kind = "sonar": must be one of imu'):
        parse_config(TEXT)


@pytest.mark.usefixtures("sonar")
def test_a_kind_of_this_file_is_subscribed_and_read_from_a_bag_and_from_csv(tmp_path: Path) -> None:
    (_, subscription) = subscriptions(parse_config(TEXT))
    assert subscription == Subscription("/sonar", "depth", "sonar")
    bag = write_bag(tmp_path / "b", "mcap", [("/sonar", START_NS, point(HUMBLE, (0.0, 0.0, 4.5)))])
    with open_recording(bag) as recording:
        assert list(recording.read([subscription])) == [RANGE]
    folder = tmp_path / "csv"
    folder.mkdir()
    (folder / "sonar.csv").write_text(f"stamp_ns,range_m\n{START_NS},4.5\n")
    with open_recording(folder) as recording:
        assert list(recording.read([Subscription("sonar", "depth", "sonar")])) == [RANGE]


@pytest.mark.usefixtures("sonar")
def test_a_kind_of_this_file_is_received_live() -> None:
    pytest.importorskip("cyclonedds")
    from holdfast.live.dds import Sample
    from holdfast.live.inputs import Inputs

    network = FakeNetwork()
    inputs = Inputs(network, subscriptions(parse_config(TEXT)))  # type: ignore[arg-type]
    assert ("/sonar", POINT) in network.subscribed
    data = bytes(HUMBLE.serialize_cdr(point(HUMBLE, (0.0, 0.0, 4.5)), POINT))
    assert inputs.decode(Sample("/sonar", POINT, data), START_NS) == [RANGE]


@pytest.mark.usefixtures("sonar")
def test_a_kind_of_this_file_is_proposed_by_config_init_and_known_to_info(tmp_path: Path) -> None:
    (tmp_path / "imu.csv").write_text(
        "stamp_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n" + "1,0,0,0,0,0,9.8\n"
    )
    rows = "".join(f"{second * 10**9},1\n" for second in (*range(20), 60, 61))
    (tmp_path / "my_sonar.csv").write_text("stamp_ns,range_m\n" + rows)
    with open_recording(tmp_path) as recording:
        config = parse_config(starter_yaml(propose("x", recording.topics, KINDS.values())))
        problems = list_problems(inspect(recording))
    assert config.sensors["sonar"].topic == "my_sonar"
    assert [problem for problem in problems if problem.startswith("my_sonar")]


@pytest.mark.usefixtures("sonar")
def test_kinds_stand_in_the_order_of_their_ranks_and_a_new_one_comes_last() -> None:
    order = [
        "imu",
        "gnss",
        "heading",
        "odometry",
        "scans",
        "twist",
        "gnss_velocity",
        "pose",
        "prism",
        "height",
        "joint",
    ]
    order += ["base_imu", "sonar"]
    assert list(KINDS) == order
    register(KINDS["imu"])
    assert list(KINDS) == order
    register(replace(SONAR, rank=-1))
    assert list(KINDS) == ["sonar", *order[:-1]]


@dataclass(frozen=True)
class TooFar:
    """What a sonar cannot have measured."""

    ranges_m: list[float]

    def summary(self) -> str:
        return f"up to {max(self.ranges_m)} m"

    def problems(self, count: int) -> Iterator[str]:
        yield f"{len(self.ranges_m)} of {count} ranges are beyond reach"

    def measured(self) -> Measured:
        return Measured(("reaches far",))


def too_far(stamps_ns: NDArray[np.int64], values: NDArray[np.float64], start_ns: int) -> TooFar:
    assert (stamps_ns - start_ns).tolist() == [0, 5, 7]
    return TooFar(values[values > 100].tolist())


@pytest.mark.usefixtures("sonar")
def test_the_check_of_a_kind_finds_values_that_info_reports(tmp_path: Path) -> None:
    register(replace(SONAR, check=too_far, rank=-1))  # before prisms, whose type it shares
    (tmp_path / "depth.csv").write_text("stamp_ns,range_m\n10,4.5\n15,200\n17,5\n")
    with open_recording(tmp_path) as recording:
        inspection = inspect(recording)
    assert inspection.topics[0].values == TooFar([200.0])
    assert "depth: 1 of 3 ranges are beyond reach" in list_problems(inspection)


def test_a_kind_without_a_row_is_refused_with_its_place() -> None:
    register_kind(SonarConfig)
    try:
        with pytest.raises(ConfigError, match=r"sensors\.depth\.kind: nothing is registered that decodes sonar"):
            subscriptions(parse_config(TEXT))
    finally:
        del SECTIONS["sonar"]
        Config.model_rebuild(force=True)


def test_a_kind_that_only_csv_files_have_is_refused_in_a_bag(tmp_path: Path) -> None:
    register(Kind("sonar", Range))
    try:
        bag = write_bag(tmp_path / "b", "mcap", [("/sonar", START_NS, point(HUMBLE, (0.0, 0.0, 4.5)))])
        with open_recording(bag) as recording, pytest.raises(RecordingError, match="none, only CSV files"):
            recording.read([Subscription("/sonar", "depth", "sonar")])
    finally:
        del KINDS["sonar"]


def test_the_page_on_recordings_lists_the_types_and_columns_of_every_kind() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for kind in KINDS.values():
        rows = [line for line in page.splitlines() if re.match(rf"\| (.*, )?{kind.name}(, .*)? \|", line)]
        assert len(rows) == 2, kind.name
        types, columns = rows
        assert all(name.replace("/msg/", "/") in types for name in kind.types)
        if kind.columns is not None:
            assert all(name in columns for name in kind.columns.names)
        else:
            assert "none" in columns
