"""What is legal but rarely meant is said, and nothing is said of a usual machine."""

import pytest

from holdfast.config.load import parse_config
from holdfast.config.review import SensorRow, sensor_rows, warnings
from holdfast.errors import ConfigError

SENSORS = "sensors:\n  imu: {{kind: imu, topic: /imu{imu}}}\n  gnss: {{kind: gnss, topic: /gnss{gnss}}}\n"
ARM = "extrinsics:\n  - {parent: imu, child: gnss, translation_m: [3, 0, 4]}\n"


def found(imu: str = "", gnss: str = "", extrinsics: str = ARM) -> list[str]:
    return warnings(parse_config(SENSORS.format(imu=imu, gnss=gnss) + extrinsics))


def test_a_usual_machine_gets_no_warning_and_its_lever_arm() -> None:
    assert found() == []
    rows = sensor_rows(parse_config(SENSORS.format(imu="", gnss="") + ARM))
    assert rows == [SensorRow("imu", "/imu", "imu", 0.0), SensorRow("gnss", "/gnss", "gnss", 5.0)]


def test_a_lever_arm_of_exactly_zero_is_said_whether_given_or_by_the_imus_frame() -> None:
    assert found(extrinsics=ARM.replace("[3, 0, 4]", "[0, 0, 0]")) == [
        "sensors.gnss: the lever arm from 'imu' to 'gnss' is exactly zero: is it measured?"
    ]
    assert found(gnss=", frame: imu", extrinsics="") == [
        "sensors.gnss: its frame is the IMU's ('imu'), so its lever arm is exactly zero"
    ]


@pytest.mark.parametrize(
    ("field", "low", "high"),
    [("gyroscope_noise_density", 1e-6, 1e-2), ("accelerometer_noise_density", 1e-5, 1e-1)],
)
def test_noise_far_from_any_imu_is_said_with_its_unit(field: str, low: float, high: float) -> None:
    assert found(imu=f", {field}: {low}") == found(imu=f", {field}: {high}") == []
    for value in (low / 2, high * 2):
        (warning,) = found(imu=f", {field}: {value}")
        assert warning.startswith(f"sensors.imu.{field} = {value:g}: outside {low:g} to {high:g} [")
        assert warning.endswith("/sqrt(Hz)], is the unit right?")


def test_a_long_time_offset_of_any_sensor_is_said() -> None:
    assert found(gnss=", time_offset_s: -0.5") == []
    assert found(gnss=", time_offset_s: -0.6")[0].startswith("sensors.gnss.time_offset_s = -0.6: more than 0.5 s")


def test_a_lidar_in_the_frame_of_the_antenna_is_said() -> None:
    text = SENSORS.format(imu="", gnss="") + "  lidar: {kind: odometry, topic: /l, frame: gnss}\n" + ARM
    assert warnings(parse_config(text)) == [
        "sensors.lidar: is in the same frame 'gnss' as sensors.gnss: are they one device?"
    ]


def test_velocities_may_well_be_those_of_one_frame_and_in_the_imu() -> None:
    wheels = "  wheels: {kind: twist, topic: /w, frame: axle}\n  slip: {kind: nonholonomic, frame: axle}\n"
    text = SENSORS.format(imu="", gnss="") + wheels + ARM + "  - {parent: imu, child: axle}\n"
    assert warnings(parse_config(text)) == []


def test_an_imu_that_is_not_the_primary_one_is_not_used() -> None:
    text = SENSORS.format(imu=", primary: true", gnss="") + "  spare: {kind: imu, topic: /imu2}\n" + ARM
    assert warnings(parse_config(text)) == ["sensors.spare: is not used, because imu is the primary IMU"]


def test_a_sensor_without_messages_has_a_row_without_topic() -> None:
    text = SENSORS.format(imu="", gnss="") + "  slip: {kind: nonholonomic, frame: imu}\n" + ARM
    assert sensor_rows(parse_config(text))[-1] == SensorRow("slip", "", "imu", 0.0)


def test_two_sensors_of_a_kind_that_read_one_topic_are_said() -> None:
    """A topic that was copied with its section made one receiver count as two antennas."""
    other = "  gnss_right: {kind: gnss, topic: /gnss}\nextrinsics:\n"
    mounts = ARM.replace("extrinsics:\n", other) + "  - {parent: imu, child: gnss_right, translation_m: [3, 2, 4]}\n"
    assert found(extrinsics=mounts) == [
        "sensors.gnss_right: reads the same topic '/gnss' as sensors.gnss: it counts twice"
    ]
    assert found(extrinsics=mounts.replace("topic: /gnss}", "topic: /gnss/right}")) == []


@pytest.mark.parametrize(
    ("mount", "words"),
    [
        ("translation_m: [3, 0, 1e12]", r"translation_m: must be within \+-1000 m, on one machine"),
        ("rotation_rpy_deg: [0, 0, 1e12]", r"rotation_rpy_deg: must be within \+-360 deg"),
    ],
)
def test_a_mount_that_no_machine_has_is_refused(mount: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        found(extrinsics=f"extrinsics:\n  - {{parent: imu, child: gnss, {mount}}}\n")


@pytest.mark.parametrize("name", ["12", "gnss right", "_gnss", "standstill"])
def test_what_a_sensor_may_be_called_is_told(name: str) -> None:
    """`12` was refused with "letters, digits and _", of which it is made."""
    with pytest.raises(ConfigError, match="is no name for a sensor: a letter, then letters, digits and _; not standst"):
        found(extrinsics=f"  '{name}': {{kind: gnss, topic: /other}}\n{ARM}")
