"""What `config init` measures of a recording: it stands in the file, and only what contradicts a default is set."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import HUMBLE, START_NS, fix, imu, odometry, stamped, twist_with_covariance, write_bag
from driven import POSITIONS, VELOCITIES, driven, received, turning
from driven import standing as at_rest

from holdfast.config.load import parse_config
from holdfast.config.model import Config
from holdfast.config.sensors import (
    GnssConfig,
    GnssVelocityConfig,
    HeadingConfig,
    ImuConfig,
    OdometryConfig,
    ScansConfig,
)
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.recording.driver_check import driver_faults
from holdfast.recording.first_config import first_config
from holdfast.recording.imu_at_rest import imu_at_rest
from holdfast.recording.source import open_recording

MS = 1_000_000
GRAVITY = np.array([0.0, 0.0, 9.81])


def standing(seconds: float = 4.0, rate: float = 1e-4, force: float = 1e-3, scale: float = 1.0) -> Iterator[Any]:
    """An IMU at 100 Hz with white noise of so many rad/s and m/s^2, which moves in its second half."""
    rng, count = np.random.default_rng(1), round(seconds * 100)
    for k in range(count):
        moves = k >= count / 2
        turn = rng.normal(size=3) * rate + moves * np.array([0.5 * np.sin(k / 5.0), 0.0, 0.2])
        specific = (GRAVITY + rng.normal(size=3) * force + moves * np.array([3.0 * np.sin(k / 7.0), 0.0, 0.0])) * scale
        stamp = START_NS + k * 10 * MS
        yield "/imu", stamp + 2 * MS, imu(HUMBLE, stamp, rate=turn, force=specific)


def fixes(sigma_m: Callable[[int], float], seconds: float = 4.0, covariance_type: int = 2) -> Iterator[Any]:
    for k in range(round(seconds * 5)):
        covariance = np.diag([sigma_m(k) ** 2] * 3).ravel()
        stamp = START_NS + k * 200 * MS
        yield "/gnss/fix", stamp + 60 * MS, fix(HUMBLE, stamp, cov=covariance, cov_type=covariance_type)


def configured(folder: Path, *rows: Iterator[Any]) -> tuple[str, Config]:
    ordered = sorted((row for part in rows for row in part), key=lambda row: row[1])
    with open_recording(write_bag(folder / "b", "mcap", ordered)) as recording:
        text = first_config(recording)
    return text, parse_config(text)


def clouds(seconds: float = 2.0, topic: str = "/ouster/points") -> Iterator[Any]:
    layout = {"height": 1, "width": 0, "fields": [], "is_bigendian": False, "point_step": 0, "row_step": 0}
    for k in range(round(seconds * 5)):
        stamp = START_NS + k * 200 * MS
        message = HUMBLE.types["sensor_msgs/msg/PointCloud2"](
            header=imu(HUMBLE, stamp).header, data=np.zeros(0, np.uint8), is_dense=True, **layout
        )
        yield topic, stamp + 210 * MS, message


def test_clouds_are_scans_where_there_is_no_odometry_and_nothing_beside_one(tmp_path: Path) -> None:
    several = standing(), clouds(), clouds(topic="/camera/depth/points"), clouds(topic="/velodyne_rear")
    text, config = configured(tmp_path / "scans", *several)
    assert isinstance(config.sensors["lidar"], ScansConfig)
    assert config.sensors["lidar"].topic == "/ouster/points"
    assert len(config.sensors) == 2
    assert "# lidar_2: /velodyne_rear" in text and "not used" in text
    tracked = ((*row[:2], odometry(HUMBLE, row[1])) for row in clouds(topic="/lidar/odometry"))
    text, config = configured(tmp_path / "odometry", standing(), clouds(), tracked)
    assert isinstance(config.sensors["lidar"], OdometryConfig)
    assert "not used beside the odometry /lidar/odometry" in text
    assert len(config.sensors) == 2


def test_five_lines_say_what_the_imu_is_like(tmp_path: Path) -> None:
    lines = configured(tmp_path, standing())[0].splitlines()
    head = lines.index(next(line for line in lines if line.startswith("  imu:")))
    about = lines[head - 4 : head]
    assert (
        about[0]
        == "  # measured in the first 120 s: 100 Hz, longest gap 0.010 s, arrives 2.0 +- 0.0 ms after its stamp"
    )
    assert about[1].startswith("  # quietest 2 s, from 0.0 s: spread 0.0001 ")
    assert about[2].startswith("  # mean specific force there 9.810 m/s^2; mean rate")
    assert about[3].startswith("  # resolution ")


def test_a_quiet_imu_keeps_the_default_noise_and_its_own_stands_beside_it(tmp_path: Path) -> None:
    text, config = configured(tmp_path, standing(rate=1e-4, force=1e-3))
    assert config.imu == ImuConfig(kind="imu", topic="/imu")
    (line,) = [line for line in text.splitlines() if line.startswith("    #gyroscope_noise_density: 0.0002")]
    assert line.endswith(("; measured 1e-05", "; measured 1.1e-05"))  # 1e-4 rad/s at 100 Hz


def test_a_noisy_imu_gets_the_density_of_its_standstill(tmp_path: Path) -> None:
    _, config = configured(tmp_path, standing(rate=0.01, force=0.1))
    assert config.imu.gyroscope_noise_density == pytest.approx(1e-3, rel=0.2)
    assert config.imu.accelerometer_noise_density == pytest.approx(1e-2, rel=0.2)


def test_noise_is_never_set_below_the_default(tmp_path: Path) -> None:
    _, config = configured(tmp_path, standing(rate=0.01, force=1e-5))
    assert config.imu.gyroscope_noise_density > 5e-4
    assert config.imu.accelerometer_noise_density == ImuConfig(kind="imu", topic="/i").accelerometer_noise_density


def test_an_imu_that_never_is_quiet_gives_no_noise(tmp_path: Path) -> None:
    text, config = configured(tmp_path, standing(rate=2.0, force=20.0))
    assert "# never quiet: its noise cannot be measured" in text
    assert config.imu == ImuConfig(kind="imu", topic="/imu")


@pytest.mark.parametrize(("unit", "factor"), [("g", 9.80665), ("mg", 0.00980665)])
def test_an_accelerometer_in_g_or_mg_gets_factors_and_a_warning(tmp_path: Path, unit: str, factor: float) -> None:
    text, config = configured(tmp_path, standing(scale=1.0 / factor))
    assert config.imu.accelerometer_factors == (factor,) * 3
    assert config.imu.gyroscope_factors == (1.0, 1.0, 1.0)
    assert text.count("# WARNING: ") == 1
    assert f"# WARNING: gravity shows that its accelerometer gives {unit}: mended by accelerometer_factors" in text
    assert "mended" not in configured(tmp_path / "good", standing())[0]


def test_specific_force_without_gravity_is_a_warning(tmp_path: Path) -> None:
    text, _ = configured(tmp_path, standing(scale=0.01))
    assert "# WARNING: the mean specific force is 0.10 m/s^2 at rest" in text
    assert "take gravity off" in text
    assert "take gravity off" not in configured(tmp_path / "good", standing())[0]


def test_a_coarse_imu_has_at_least_the_noise_of_its_resolution() -> None:
    rng, step = np.random.default_rng(2), 0.05
    values = np.round((rng.normal(size=(1000, 6)) * 0.03 + np.r_[np.zeros(3), GRAVITY]) / step) * step
    found = imu_at_rest(np.arange(1000) * 10 * MS, values, 0)
    assert found is not None
    assert (found.rate_step_rad_s, found.force_step_m_s2) == pytest.approx((step, step))
    assert found.gyroscope_noise_density >= step / np.sqrt(12.0) * 0.1


def test_repeats_and_drop_outs_are_no_quiet_time() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(1000, 6)) * 0.01 + np.r_[np.zeros(3), GRAVITY]
    values[200:600] = values[200]
    stamps = np.arange(1000) * 10 * MS
    found = imu_at_rest(stamps, values, 0)
    assert found is not None
    assert found.gyroscope_noise_density == pytest.approx(1e-3, rel=0.2)
    assert imu_at_rest(stamps[:10], values[:10], 0) is None
    assert imu_at_rest(stamps, np.full((1000, 6), np.nan), 0) is None


def test_a_receiver_that_claims_metres_is_let_in(tmp_path: Path) -> None:
    text, config = configured(tmp_path, standing(), fixes(lambda _: 2.0))
    assert config.sensors_of(GnssConfig)["gnss"].max_sigma_m == pytest.approx(4.0)
    assert "95 % claim up to 2" in text
    _, config = configured(tmp_path / "good", standing(), fixes(lambda k: 5.0 if k == 7 else 0.02, 8.0))
    assert config.sensors_of(GnssConfig)["gnss"].max_sigma_m == GnssConfig(kind="gnss", topic="/g").max_sigma_m


def test_only_the_first_two_minutes_are_read(tmp_path: Path) -> None:
    late = ((topic, at + 130_000 * MS, message) for topic, at, message in standing(rate=0.01))
    text, config = configured(tmp_path, standing(), late)
    assert "WARNING" not in text
    assert config.imu == ImuConfig(kind="imu", topic="/imu")


def moving(
    motion: Any = turning,
    fix_early_s: float = 0.0,
    velocity_early_s: float = 0.0,
    *,
    unit_rad_s: float = 1.0,
    unit_m_s2: float = 1.0,
    axes: tuple[int, ...] = (0, 1, 2),
    heading_sign: float = 1.0,
    ahead_s: float = 0.0,
    late_s: float = 0.0,
) -> Iterator[Any]:
    """A drive without a word on mounts and lever arms, the receiver's heading beside it.

    The receiver's clock is ahead by so much, and what it says is so late.
    """
    ahead_ns, late_ns = round(ahead_s * 1e9), round(late_s * 1e9)
    for t, row in zip(*driven(motion), strict=True):
        stamp, rate = START_NS + round(t * 1e9), row[:3] / unit_rad_s
        yield "/imu", stamp, imu(HUMBLE, stamp, rate=rate, force=row[3:] / unit_m_s2)
    frame = LocalFrame(Geodetic(47.4, 8.0, 450.0))
    for t, p in zip(*received(motion, POSITIONS, 0.01, fix_early_s, 4), strict=True):
        at = START_NS + round(t * 1e9) + late_ns
        stamp = at - late_ns + ahead_ns
        yield "/gnss/fix", at, fix(HUMBLE, stamp, position=frame.to_geodetic(p))
        half = 0.5 * heading_sign * float(motion(np.array([t]))[1][0])
        turned = HUMBLE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(half), np.cos(half))
        yield "/gnss/heading", at, stamped(HUMBLE, stamp, "QuaternionStamped", turned)
    for t, v in zip(*received(motion, VELOCITIES, 0.03, velocity_early_s, 4), strict=True):
        at = START_NS + round(t * 1e9) + late_ns
        stamp = at - late_ns + ahead_ns
        message = twist_with_covariance(HUMBLE, np.eye(6).ravel() * 1e-3, linear=v[list(axes)])
        yield "/gnss/velocity", at, stamped(HUMBLE, stamp, "TwistWithCovarianceStamped", message)


def offsets(config: Config) -> list[float]:
    kinds = GnssConfig, GnssVelocityConfig, HeadingConfig
    return [section.time_offset_s for kind in kinds for section in config.sensors_of(kind).values()]


def test_the_clock_of_a_receiver_is_set_where_its_stamps_are_early(tmp_path: Path) -> None:
    text, config = configured(tmp_path, moving(fix_early_s=0.1, velocity_early_s=0.1))
    assert offsets(config) == [pytest.approx(0.1, abs=0.02)] * 3
    assert len(set(offsets(config))) == 1
    assert text.count("added to every stamp of this sensor; measured +0.") == 3
    assert "clock against the IMU" not in text


def test_a_velocity_that_is_late_against_the_fixes_gets_an_offset_of_its_own(tmp_path: Path) -> None:
    fixes_s, velocity_s, heading_s = offsets(configured(tmp_path, moving(fix_early_s=0.25, velocity_early_s=0.1))[1])
    assert fixes_s == heading_s == pytest.approx(0.25, abs=0.04)
    assert velocity_s == pytest.approx(0.1, abs=0.04)


@pytest.mark.parametrize("ahead_s", [-18.0, 18.0, -3.0])
def test_a_clock_that_is_off_by_leap_seconds_is_set(tmp_path: Path, ahead_s: float) -> None:
    _, config = configured(tmp_path, moving(ahead_s=ahead_s))
    assert offsets(config) == [pytest.approx(-ahead_s, abs=0.03)] * 3


def test_a_receiver_whose_messages_are_late_has_the_right_clock(tmp_path: Path) -> None:
    _, config = configured(tmp_path, moving(late_s=3.0))
    assert offsets(config) == [0.0] * 3


def test_a_clock_of_another_day_is_a_warning(tmp_path: Path) -> None:
    text, config = configured(tmp_path, moving(ahead_s=86400.0))
    assert offsets(config) == [0.0] * 3
    assert text.count("# WARNING: its stamps are 86400 s ahead of the IMU's, by their arrivals; both drivers must") == 2


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Config]:
    """What is measured of a drive on which nothing is wrong."""
    return configured(tmp_path_factory.mktemp("right"), moving())


def test_a_clock_that_is_right_stays_alone_and_a_note_says_how_well_it_is_known(
    tmp_path: Path, right: tuple[str, Config]
) -> None:
    text, config = right
    assert offsets(config) == [0.0] * 3
    assert text.count("  # clock against the IMU: ") == 3
    text, config = configured(tmp_path / "still", moving(at_rest, 0.2, 0.2))
    assert offsets(config) == [0.0] * 3
    assert text.count("# clock against the IMU: too little motion to measure it") == 3


@pytest.mark.parametrize(("unit_rad_s", "unit_m_s2"), [(np.pi / 180.0, 1.0), (np.pi / 180.0, 9.80665), (1.0, -1.0)])
def test_an_imu_that_goes_otherwise_than_its_antennas_gets_factors_and_all_else_is_measured_with_them(
    tmp_path: Path, right: tuple[str, Config], unit_rad_s: float, unit_m_s2: float
) -> None:
    text, config = configured(
        tmp_path, moving(fix_early_s=0.1, velocity_early_s=0.1, unit_rad_s=unit_rad_s, unit_m_s2=unit_m_s2)
    )
    assert config.imu.gyroscope_factors == pytest.approx([unit_rad_s] * 3)
    assert config.imu.accelerometer_factors == pytest.approx([unit_m_s2] * 3)
    assert "# WARNING: " in text and ": mended by " in text
    assert offsets(config) == [pytest.approx(0.1, abs=0.02)] * 3
    text, config = right
    assert "mended" not in text
    assert config.imu.factors is None


def test_noise_is_measured_in_the_units_that_are_meant(tmp_path: Path) -> None:
    of = [
        configured(tmp_path / name, standing(rate=0.01, scale=s))[1].imu for name, s in (("si", 1.0), ("g", 1 / 9.81))
    ]
    assert of[1].accelerometer_factors == (9.80665, 9.80665, 9.80665)
    assert of[0].gyroscope_noise_density == of[1].gyroscope_noise_density > 5e-4
    assert of[0].accelerometer_noise_density == of[1].accelerometer_noise_density


def test_where_a_run_goes_badly_the_keys_that_the_driver_contradicts_are_named(tmp_path: Path) -> None:
    rows = sorted(moving(unit_rad_s=np.pi / 180.0), key=lambda row: row[1])
    with open_recording(write_bag(tmp_path / "b", "mcap", rows)) as recording:
        right = parse_config(first_config(recording))
        given = right.imu.model_copy(update={"gyroscope_factors": (1.0, 1.0, 1.0)})
        wrong = right.model_copy(update={"sensors": {**right.sensors, right.imu_name: given}})
        assert driver_faults(recording, right) == []
        (line,) = driver_faults(recording, wrong)
    assert line.startswith("sensors.imu.gyroscope_factors looks wrong (it goes with the motion of the antennas as if ")
    assert line.endswith(": [0.0174533, 0.0174533, 0.0174533]")


def test_a_velocity_that_goes_otherwise_than_the_fixes_is_a_warning_and_spoils_no_other_measurement(
    tmp_path: Path,
) -> None:
    text, config = configured(tmp_path, moving(fix_early_s=0.1, velocity_early_s=0.1, axes=(1, 0, 2)))
    assert "# WARNING: it goes with the fixes of /gnss/fix as if it were north, east (NED), not east, north" in text
    assert "motion of the antennas" not in text
    assert offsets(config) == [pytest.approx(0.1, abs=0.02), 0.0, pytest.approx(0.1, abs=0.02)]


def test_a_heading_that_counts_clockwise_is_configured_so_and_its_clock_is_that_of_its_receiver(
    tmp_path: Path, right: tuple[str, Config]
) -> None:
    text, config = configured(tmp_path, moving(fix_early_s=0.1, velocity_early_s=0.1, heading_sign=-1.0))
    assert "; it turns the other way than the gyroscope, as a compass does" in text
    assert [one.clockwise for one in config.sensors_of(HeadingConfig).values()] == [True]
    assert len(set(offsets(config))) == 1
    assert "clockwise: true" not in right[0] and "turns the other way" not in right[0]


def test_receivers_that_never_sent_anything_are_no_error(tmp_path: Path) -> None:
    kinds = {row[0]: row for row in moving()}
    late = ((topic, START_NS + 400_000 * MS, message) for topic, _, message in kinds.values() if topic != "/imu")
    _, config = configured(tmp_path, standing(), late)
    assert offsets(config) == [0.0] * 3
