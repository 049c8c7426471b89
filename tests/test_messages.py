"""A message with a wrong argument says which, what it must be, and what came; a sound one passes whatever it holds."""

import numpy as np
import pytest

from holdfast import Config, Estimator, HoldfastError, MessageError, RealtimeEstimator
from holdfast.config.load import parse_config
from holdfast.config.model import GateConfig
from holdfast.errors import ConfigError
from holdfast.geometry.earth import Geodetic
from holdfast.messages import (
    FixStatus,
    GnssFix,
    GnssVelocity,
    Heading,
    Height,
    ImuSample,
    JointAngle,
    PointPosition,
    SensorPose,
    Twist,
)

V3, V4, M3, M6 = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3), np.eye(6)
SOUND = {
    ImuSample: (V3, V3),
    GnssFix: (47.0, 8.0, 400.0, M3, FixStatus.GBAS),
    GnssVelocity: (V3, M3),
    SensorPose: (V3, V4, M6),
    Heading: (0.1, 0.01),
    JointAngle: (0.1,),
    Twist: (V3, V3, M6),
    PointPosition: (V3, M3),
    Height: (1.0, 0.1),
}
CONFIG = """
sensors:
  imu: {kind: imu, topic: /imu}
  gnss: {kind: gnss, topic: /fix, frame: imu}
  heading: {kind: heading, topic: /heading}
  lidar: {kind: odometry, topic: /lidar, frame: imu}
"""


@pytest.mark.parametrize("kind", SOUND, ids=lambda kind: kind.__name__)
def test_every_field_of_every_message_is_named_when_it_is_wrong(kind):
    kind(1, 2, "name", *SOUND[kind])
    names = [*kind.QUANTITIES, *(["status"] if kind is GnssFix else [])]
    assert len(names) == len(SOUND[kind])
    for index, name in enumerate(names):
        for wrong in ("a word", np.zeros((3, 1)), np.zeros(2), np.array(["x", "y", "z"]), {}, True, 1j):
            fields = list(SOUND[kind])
            fields[index] = wrong
            if kind is ImuSample and getattr(wrong, "shape", None) == (3,):
                continue  # is found when it is processed
            with pytest.raises(MessageError, match=rf"^{kind.__name__}\.{name}: must be .*, got "):
                kind(1, 2, "name", *fields)


@pytest.mark.parametrize("kind", SOUND, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("stamp", [1.5, "1", None, 10**40, -(10**40), [1]])
def test_stamps_are_whole_nanoseconds_of_64_bits(kind, stamp):
    with pytest.raises(MessageError, match=rf"^{kind.__name__}\.stamp_ns: must be a whole number of nanoseconds"):
        kind(stamp, 2, "name", *SOUND[kind])
    with pytest.raises(MessageError, match=rf"^{kind.__name__}\.arrival_ns: must be a whole number of nanoseconds"):
        kind(1, stamp, "name", *SOUND[kind])
    kind(np.int64(1), -2, "name", *SOUND[kind])


@pytest.mark.parametrize("kind", SOUND, ids=lambda kind: kind.__name__)
def test_what_is_not_finite_passes_and_a_row_gives_the_message_back(kind):
    message = kind(1, 2, "name", *SOUND[kind])
    again = kind.of(1, 2, "name", message.values())
    assert again.values() == message.values()
    nowhere = kind.of(1, 2, "name", [np.nan] * 3 + list(message.values())[3:])
    assert np.isnan(nowhere.values()[0])


WRONG = {
    "angular_velocity": lambda e: e.add_imu(1, [0.0, 0.0], V3),
    "specific_force": lambda e: e.add_imu(1, V3, np.zeros((3, 1))),
    r"angular_velocity: must be an array \(3,\) of numbers \[rad/s\], got 'abc' ": lambda e: e.add_imu(1, "abc", V3),
    r"specific_force: must be an array \(3,\) of numbers \[m/s\^2\], got a list": lambda e: e.add_imu(
        1, V3, [[1], 2, 3]
    ),
    "stamp_ns: must be a whole number of nanoseconds": lambda e: e.add_imu(1.7e9, V3, V3),
    "latitude_deg: must be a number .deg., got 'north'": lambda e: e.add_gnss(1, "north", 8.0, 400.0),
    r"covariance: must be an array \(3, 3\) of numbers \[m\^2\]": lambda e: e.add_gnss(
        1, 47.0, 8.0, 1.0, covariance=[1.0]
    ),
    "status: must be one of .*2 GBAS, got 7": lambda e: e.add_gnss(1, 47.0, 8.0, 400.0, status=7),
    "yaw_rad: must be a number": lambda e: e.add_heading(1, [0.1]),
    r"angular_velocity: must be an array \(3,\) of numbers \[rad/s\], got a list of 3": lambda e: e.add_imu(
        1, [10**400, 0, 0], V3
    ),
    r"specific_force: must be an array \(3,\) of numbers \[m/s\^2\], got a list of 3: \['1'": lambda e: e.add_imu(
        1, V3, ["1", "2", "3"]
    ),
    r"angular_velocity: .*, got an array \(3,\) of complex128": lambda e: e.add_imu(1, V3 * 1j, V3),
    r"specific_force: .*, got an array \(3,\) of bool": lambda e: e.add_imu(1, V3, V3 == 0.0),
    r"angular_velocity: .*, got a list of 3: \[None": lambda e: e.add_imu(1, [None, 0.0, 0.0], V3),
    "stamp_ns: must be a whole number of nanoseconds within 64 bits, got True": lambda e: e.add_imu(True, V3, V3),
    "arrival_ns: must be a whole number of nanoseconds .*, got True": lambda e: e.add_imu(1, V3, V3, True),
    "latitude_deg: must be a number .deg., got a number of more than 64 bits": lambda e: e.add_gnss(
        1, 10**400, 8.0, 5.0
    ),
    "yaw_rad: must be a number .rad., got a number of more": lambda e: e.add_heading(1, -(10**400)),
    r"covariance: must be an array \(3, 3\) of numbers .*, got a list of 3: ": lambda e: e.add_gnss(
        1, 47.0, 8.0, 5.0, covariance=[[10**400, 0, 0], [0, 1, 0], [0, 0, 1]]
    ),
    r"position: must be an array \(3,\)": lambda e: e.add_odometry(1, [1.0], V4),
    r"quaternion: must be an array \(4,\)": lambda e: e.add_odometry(1, V3, V3),
    r"covariance: must be an array \(6, 6\)": lambda e: e.add_odometry(1, V3, V4, covariance=M3),
}


@pytest.fixture(scope="module", params=[Estimator, RealtimeEstimator], ids=lambda kind: kind.__name__)
def engine(request):
    made = request.param(parse_config(CONFIG))
    yield made
    if isinstance(made, RealtimeEstimator):
        made.close()


@pytest.mark.parametrize("words", WRONG)
def test_both_engines_name_the_argument_that_is_wrong_and_go_on(engine, words):
    with pytest.raises(MessageError, match=words):
        WRONG[words](engine)
    engine.add_imu(1, [0, 0, 0], (0.0, 0.0, 9.81))


def test_an_arrival_of_zero_is_one_like_any_other():
    """It was taken for none: of a simulation's clock, the first message had come at the time of this machine."""
    engine, taken = Estimator(parse_config(CONFIG)), []
    engine.process = taken.append
    engine.add_imu(0, V3, V3, 0)
    engine.add_gnss(0, 47.0, 8.0, 400.0, arrival_ns=0)
    engine.add_heading(0, 0.0, arrival_ns=0)
    engine.add_odometry(0, V3, V4, arrival_ns=0)
    assert [message.arrival_ns for message in taken] == [0] * 4
    engine.add_imu(0, V3, V3)
    assert taken[-1].arrival_ns > 10**18


def test_readings_that_are_no_numbers_are_named_when_they_are_processed():
    for words, dtype in (
        (["x", "y", "z"], "<U1"),
        (["1", "2", "3"], "<U1"),
        ([1j, 0, 0], "complex128"),
        ([10**400, 0, 0], "object"),
    ):
        with pytest.raises(MessageError, match=rf"^ImuSample.angular_velocity: must be .* of {dtype}$"):
            Estimator(parse_config(CONFIG)).process(ImuSample(1, 2, "imu", np.array(words), V3))


def test_whole_numbers_that_a_double_can_be_are_taken_however_long_they_are():
    engine = Estimator(parse_config(CONFIG))
    engine.add_imu(1, [2**70, 0, 0], [0, 0, 9])
    for stamp_ns in (-1, np.uint64(4), np.int64(5)):  # numpy would overflow where these are compared
        engine.add_imu(stamp_ns, V3, V3, np.int64(3))
    engine.add_gnss(1, 47, 8, 2**70)


def test_both_engines_take_in_the_same_arguments():
    methods = {name for name in dir(RealtimeEstimator) if name.startswith("add_")}
    assert methods >= {"add_imu", "add_gnss", "add_heading", "add_odometry", "add_joint", "add_base_imu"}
    assert all(getattr(Estimator, name) is getattr(RealtimeEstimator, name) for name in methods)


@pytest.mark.parametrize(
    ("make", "lines"),
    [
        (Config, ["Config: sensors: missing, must be names, each with a section"]),
        (
            lambda: GateConfig(lag=3, lose_after=0),
            ["GateConfig: lose_after = 0: must be >= 1", "GateConfig: lag: unknown key, allowed are innovation, "],
        ),
        (
            lambda: Config(sensors={"a": {"kind": "gns"}}),
            ['Config: sensors.a: kind = "gns": did you mean gnss? must be one of imu, '],
        ),
        (lambda: Config(sensors={}), ["Config: sensors: needs a sensor with `kind: imu`"]),
        (lambda: Config(sensors=V3), ['Config: sensors = "array([0., 0., 0.])": must be names, each with a section']),
    ],
)
def test_a_section_made_in_a_program_says_what_is_wrong_in_one_line_per_fault(make, lines):
    with pytest.raises(ConfigError) as caught:
        make()
    assert isinstance(caught.value, HoldfastError)
    found = str(caught.value).splitlines()
    assert len(found) == len(lines)
    assert all(text.startswith(words) for text, words in zip(found, lines, strict=True)), found


@pytest.mark.parametrize("engine", [Estimator, RealtimeEstimator])
def test_a_datum_or_a_sensor_that_is_none_is_refused_by_name_and_changes_nothing(engine):
    """A tuple was an AttributeError, None a silent reset, and the noise of an unknown sensor was 1."""
    estimator = engine(parse_config(CONFIG))
    try:
        estimator.set_datum(Geodetic(47.0, 8.0, 400.0))
        for wrong in (None, (47, 8, 500), Geodetic(47.0, "8", 500.0), Geodetic(47.0, 8.0, True)):
            with pytest.raises(
                ConfigError, match=r"^datum: must be a Geodetic \(latitude_deg, longitude_deg, alt.*, got"
            ):
                estimator.set_datum(wrong)
        for wrong in (Geodetic(90.1, 8.0, 0.0), Geodetic(47.0, 8.0, np.inf), Geodetic(47.0, -361.0, 0.0)):
            with pytest.raises(ConfigError, match=r"^datum: must be finite, of a latitude within 90 deg"):
                estimator.set_datum(wrong)
        assert estimator.datum == Geodetic(47.0, 8.0, 400.0)
        assert estimator.noise("gnss") == estimator.noise("imu") == 1.0
        for unknown in ("typo", None, []):
            with pytest.raises(
                ConfigError, match=r"^sensor: .* is not in the configuration \(allowed: imu, gnss, head"
            ):
                estimator.noise(unknown)
    finally:
        if engine is RealtimeEstimator:
            estimator.close()


SENSORS = parse_config("sensors: {imu: {kind: imu, topic: /imu}, gnss: {kind: gnss, topic: /fix, frame: imu}}\n")


@pytest.mark.parametrize("engine", [Estimator, RealtimeEstimator])
def test_a_message_of_another_kind_than_its_sensor_is_refused_by_name(engine):
    """A heading by the name of an antenna was an AttributeError, a fix by that of the IMU was lost without a word."""
    estimator = engine(SENSORS)
    try:
        for message, words in (
            (Heading(1, 1, "gnss", 0.1, None), "of sensor 'gnss' must be of type GnssFix, not Heading"),
            (ImuSample(1, 1, "gnss", V3, V3), "of sensor 'gnss' must be of type GnssFix, not ImuSample"),
            (GnssFix(1, 1, "imu", 47.0, 8.0, 400.0, M3, FixStatus.FIX), "of sensor 'imu' must be of type ImuSample"),
        ):
            with pytest.raises(MessageError, match=words):
                estimator.process(message)
        assert not estimator.counts
    finally:
        estimator.close()
