"""What was learnt, in a file: it comes back as it was, holds for the numbers it was learnt by, and is never half."""

import json
import sys
from math import atan2, degrees, radians
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "estimator"))

from motion import ARM, ARM_RIGHT, T_I_L, machine

from holdfast.calibration.learnt_file import check_learnt_file, load_learnt, save_learnt
from holdfast.calibration.learnt_table import learnt_rows, plain_rows, wrong_lines
from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.integrity.learnt_snapshot import (
    NAMES_ARE_RIGHT,
    NOTHING_LEARNT,
    LearntNames,
    LearntNoiseScale,
    LearntOdometry,
    LearntScale,
    LearntSnapshot,
    LearntYaw,
)
from holdfast.sensors.constants import LearntConstant
from holdfast.sensors.lever_arm import GNSS_ARM

TURNED = (0.02, -0.01, 0.03)
YAW = LearntYaw(log_means=(0.0, 1.5, 0.0), log_covariance=((0.1, 0.0, 0.0), (0.0, 0.06, 0.0), (0.0, 0.0, 0.1)))
LIDAR = LearntOdometry(
    translation_noise=LearntScale(log_mean=0.1, log_sigma=0.2),
    translation_drift=LearntScale(log_mean=-0.85, log_sigma=0.19),
    rotation_drift=LearntScale(log_mean=1.4, log_sigma=0.19),
    yaw=YAW,
)
KNOWN = LearntSnapshot(
    odometries={"lidar": LIDAR},
    noise={"gnss": LearntNoiseScale(log_factor=3.0, white_variance=0.4, white_count=50)},
    constants={
        "lidar": LearntConstant(mean=(*TURNED, 0.035), sigmas=(1e-3, 1e-3, 1e-3, 1e-3), is_off=True),
        "clock of GNSS": LearntConstant(mean=(1e-5,), sigmas=(1e-4,)),
    },
    accelerometer=LearntScale(log_mean=0.2, log_sigma=0.3),
)


@pytest.fixture
def file(tmp_path):
    found = tmp_path / "learnt.json"
    save_learnt(found, KNOWN, machine())
    return found


def test_it_comes_back_as_it_was(file):
    assert load_learnt(file, machine()) == (KNOWN, [])
    assert [one.name for one in file.parent.iterdir()] == [file.name]  # nothing half beside it


def test_a_file_that_is_not_there_holds_nothing_and_one_that_cannot_be_written_is_told_first(tmp_path):
    assert load_learnt(tmp_path / "none.json", machine()) == (NOTHING_LEARNT, [])
    with pytest.raises(ConfigError, match=r"none\.json: cannot be written \(its folder does not exist\)"):
        load_learnt(tmp_path / "nowhere" / "none.json", machine())
    with pytest.raises(ConfigError, match="cannot be read: is a directory"):
        load_learnt(tmp_path, machine())


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (["schema_version"], 2, "schema_version = 2: must be one of 1"),
        (["learnt", "odometries", "lidar", "rotation_drift", "log_sigma"], -1.0, "log_sigma = -1.0: must be > 0"),
        (["learnt", "odometries", "lidar", "wheel"], 1.0, "wheel: unknown key"),
        (["learnt", "odometries", "lidar", "yaw", "log_covariance", 0, 0], -9.0, "symmetric and positive definite"),
        (["learnt", "constants", "lidar", "sigmas"], [1.0], "one for each number of mean"),
        (["learnt", "noise"], 3, "learnt.noise"),
    ],
)
def test_a_file_that_is_wrong_is_one_line_with_the_key_and_what_is_allowed(file, path, value, words):
    data = json.loads(file.read_text())
    at = data
    for part in path[:-1]:
        at = at[part]
    at[path[-1]] = value
    file.write_text(json.dumps(data))
    with pytest.raises(ConfigError) as error:
        load_learnt(file, machine())
    (line,) = str(error.value).splitlines()
    assert line.startswith(str(file)) and words in line and "(allowed: " in line


@pytest.mark.parametrize(
    "text", ["", "{", "[1, 2]", "sensors:\n  imu: {}\n", "null", '{"learnt": {"noise": NaN}}', "\x00"]
)
def test_what_is_no_such_file_is_one_line_too(file, text):
    file.write_text(text)
    with pytest.raises(ConfigError) as error:
        load_learnt(file, machine())
    assert len(str(error.value).splitlines()) == 1 and str(file) in str(error.value)


def test_bytes_that_are_no_text_are_one_line(file):
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="is no utf-8 text"):
        load_learnt(file, machine())


def test_sensors_that_are_not_configured_are_ignored_with_a_warning(file):
    learnt, (warning,) = load_learnt(file, machine(lidar=False))
    assert warning == "lidar: is not configured: what was learnt of it is ignored"
    assert learnt == KNOWN.model_copy(
        update={"odometries": {}, "constants": {"clock of GNSS": KNOWN.constants["clock of GNSS"]}}
    )


@pytest.mark.parametrize(
    ("changed", "lost"),
    [
        ({"lidar_": {"drift_m_per_sqrt_m": 0.02}}, {"odometries.lidar"}),
        ({"lidar_": {"time_offset_s": 0.035}}, {"constants.lidar"}),
        ({"lidar_": {"mounting_sigma_deg": 2.0}}, {"constants.lidar"}),
        ({"gnss_": {"min_sigma_m": 0.02}}, {"noise.gnss"}),
        ({"gnss_": {"time_offset_s": 0.01}}, {"constants.clock of GNSS"}),
        ({"lidar_": {"topic": "/lidar/pose", "jump_sigma": 9.0}}, set()),
    ],
)
def test_a_key_that_has_changed_since_is_the_firmer_word(file, changed, lost):
    learnt, warnings = load_learnt(file, machine(**changed))
    kept = {f"{part}.{name}" for part, of in learnt.model_dump().items() for name in of}
    assert {f"{part}.{name}" for part, of in KNOWN.model_dump().items() for name in of} - kept == lost
    assert len(warnings) == len(lost)
    for warning in warnings:
        assert all(key in warning for section in changed.values() for key in section) and "->" in warning


def test_a_lidar_that_was_moved_in_the_file_forgets_its_mounting(file):
    config = machine()
    links = [
        one | {"translation_m": (0.0, 0.0, 1.0)} if one["child"] == "lidar" else one
        for one in config.model_dump()["extrinsics"]
    ]
    other = type(config).model_validate(config.model_dump(exclude_unset=True) | {"extrinsics": links})
    learnt, (warning,) = load_learnt(file, other)
    assert learnt.constants.keys() == {"clock of GNSS"} and learnt.odometries == KNOWN.odometries
    assert "of its frame" in warning


def test_with_another_gyroscope_only_what_rests_on_it_is_forgotten(file):
    learnt, _ = load_learnt(file, machine(imu_={"gyroscope_error_ratio": 0.01}))
    assert learnt.odometries["lidar"] == LIDAR.model_copy(update={"yaw": None})
    assert learnt.constants == KNOWN.constants and learnt.accelerometer is None


def test_a_file_where_the_results_go_or_that_is_read_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="which is replaced by each run"):
        check_learnt_file(tmp_path / "out" / "learnt.json", tmp_path / "out", [])
    (tmp_path / "machine.yaml").touch()
    with pytest.raises(ConfigError, match="which is read"):
        check_learnt_file(tmp_path / "machine.yaml", tmp_path / "out", [str(tmp_path / "machine.yaml")])
    check_learnt_file(tmp_path / "learnt.json", tmp_path / "out", [])


# --- what is told -----------------------------------------------------------------------------------------------------


def by_what(config=None):
    return {(row.sensor, row.what, row.key.split(".")[-1]): row for row in learnt_rows(KNOWN, config or machine())}


def test_factors_are_told_as_the_numbers_that_the_file_should_hold():
    rows = by_what()
    drift = rows["lidar", "rotation drift", "drift_rad_per_sqrt_rad"]
    assert (drift.configured, drift.looks_wrong) == (0.005, True)
    assert drift.learnt == pytest.approx(0.005 * 4.055, rel=0.01) and drift.unit == "sqrt(rad)"
    better = rows["lidar", "translation drift", "drift_m_per_sqrt_m"]
    assert better.learnt == pytest.approx(0.04 * 0.427, rel=0.01) and better.looks_wrong
    assert not rows["lidar", "translation noise", "translation_sigma_m"].looks_wrong


def test_the_larger_of_two_factors_on_one_key_is_what_to_write():
    rows = by_what()
    of_yaw, of_all = (rows["lidar", what, "drift_rad_per_sqrt_rad"] for what in ("yaw drift", "rotation drift"))
    assert of_yaw.looks_wrong and of_yaw.write == of_all.write == f"{max(of_yaw.learnt, of_all.learnt):.3g}"


def test_constants_are_told_with_the_value_to_write():
    rows = by_what()
    clock = rows["lidar", "clock", "time_offset_s"]
    assert clock.looks_wrong and clock.write == "0.0350" and clock.sigma == 1e-3
    about_z = rows["lidar", "mounting, about its z", "rotation_matrix"]
    assert about_z.looks_wrong and about_z.learnt == pytest.approx(1.719, abs=0.001) and about_z.write.startswith("[[")
    assert not rows["gnss", "clock", "time_offset_s"].looks_wrong


def test_a_lever_arm_is_told_along_the_axes_that_are_known():
    """In the axes of the lidar, which are not those of the entry; what nobody saw stays as the file has it."""
    arm = LearntConstant(mean=(-1.6, 0.01, 0.4), sigmas=(0.02, 0.02, 1.5), is_off=True)
    config = machine()
    written = np.array(T_I_L.transformFrom(np.array([-1.6, 0.0, 0.0])))
    rows = {row.what: row for row in learnt_rows(LearntSnapshot(constants={"lidar arm": arm}), config)}
    along_x = rows["lever arm, along its x"]
    assert (along_x.looks_wrong, along_x.learnt, along_x.unit) == (True, -1.6, "m")
    assert along_x.key.endswith("translation_m")
    assert json.loads(along_x.write) == pytest.approx(written, abs=1e-3)
    assert not rows["lever arm, along its y"].looks_wrong and not rows["lever arm, along its z"].looks_wrong
    right = LearntSnapshot(constants={"lidar arm": arm.model_copy(update={"is_off": False})})
    assert not learnt_rows(right, config)


def test_a_shift_of_the_antennas_is_told_of_each_as_what_to_write():
    shift = LearntConstant(mean=(1.0, -0.5, 0.0), sigmas=(0.02, 0.02, 0.0006), is_off=True)
    rows = learnt_rows(LearntSnapshot(constants={GNSS_ARM: shift}), machine(right=True))
    for name, arm in (("gnss", ARM), ("gnss_right", ARM_RIGHT)):
        x, y, z = (row for row in rows if row.sensor == name)
        assert x.looks_wrong and y.looks_wrong and not z.looks_wrong
        assert (x.configured, x.learnt) == pytest.approx((arm[0], arm[0] + 1.0))
        assert json.loads(x.write) == pytest.approx(arm + np.array([1.0, -0.5, 0.0]), abs=1e-3)
    right = LearntSnapshot(constants={GNSS_ARM: shift.model_copy(update={"is_off": False})})
    assert not learnt_rows(right, machine())


def test_how_a_heading_is_mounted_is_told_as_what_to_write_once_it_is_known():
    mount = LearntConstant(mean=(radians(-10.0),), sigmas=(radians(0.1),), is_off=True)
    baseline = machine(right=True, heading=True)
    axis = ARM_RIGHT - ARM
    for config, yaw_deg in (
        (machine(heading=True, heading_={"mounting_yaw_deg": 30.0}), 30.0),
        (baseline, degrees(atan2(axis[1], axis[0]))),
    ):
        (row,) = learnt_rows(LearntSnapshot(constants={"heading mount": mount}), config)
        assert (row.key, row.what, row.looks_wrong) == ("sensors.heading.mounting_yaw_deg", "mounting, yaw", True)
        assert (row.configured, row.learnt) == pytest.approx((yaw_deg, yaw_deg - 10.0))
        assert float(row.write) == pytest.approx(yaw_deg - 10.0, abs=0.01)
    vague = LearntConstant(mean=(0.001,), sigmas=(radians(0.28),))
    assert not learnt_rows(LearntSnapshot(constants={"heading mount": vague}), baseline)


def test_how_a_heading_is_mounted_is_kept_until_it_or_an_antenna_of_its_baseline_is_mounted_otherwise(tmp_path):
    known = LearntSnapshot(constants={"heading mount": LearntConstant(mean=(0.1,), sigmas=(0.01,), is_off=True)})
    save_learnt(tmp_path / "learnt.json", known, machine(right=True, heading=True))
    for changed in ({"heading_": {"mounting_yaw_deg": 20.0}}, {"gnss_": {"lever_arm_sigma_m": 0.1}}):
        learnt, (warning,) = load_learnt(tmp_path / "learnt.json", machine(right=True, heading=True, **changed))
        assert not learnt.constants and "changed since it was learnt" in warning
    later, _ = load_learnt(
        tmp_path / "learnt.json", machine(right=True, heading=True, heading_={"time_offset_s": 0.01})
    )
    assert later.constants == known.constants


def test_a_lever_arm_is_kept_until_the_frame_is_moved(tmp_path):
    arm = LearntConstant(mean=(-1.6, 0.01, 0.4), sigmas=(0.02, 0.02, 1.5), is_off=True)
    known = LearntSnapshot(constants={"lidar arm": arm})
    save_learnt(tmp_path / "learnt.json", known, machine())
    assert load_learnt(tmp_path / "learnt.json", machine()) == (known, [])
    learnt, (warning,) = load_learnt(tmp_path / "learnt.json", machine(lidar_={"mounting_sigma_deg": 2.0}))
    assert not learnt.constants and "mounting_sigma_deg" in warning
    assert not load_learnt(tmp_path / "learnt.json", machine(lidar=False))[0].constants
    later, _ = load_learnt(tmp_path / "learnt.json", machine(lidar_={"time_offset_s": 0.01}))
    assert later.constants == known.constants  # the clock of a sensor does not move it


def test_a_boastful_receiver_is_told():
    row = by_what()["gnss", "noise, times what it claims", "min_sigma_m"]
    assert row.learnt > 2.0 and row.looks_wrong


def test_the_end_of_a_command_has_a_few_lines_one_for_each_key():
    rows = learnt_rows(KNOWN, machine())
    lines = wrong_lines(rows)
    assert len(lines) == 5 and "keys more" in lines[-1]
    assert lines[0] == "sensors.lidar.time_offset_s looks wrong (lidar, clock): 0.0350, is 0"
    assert wrong_lines(learnt_rows(NOTHING_LEARNT, machine())) == []


def test_the_rows_are_plain_data():
    rows = plain_rows(learnt_rows(KNOWN, machine()))
    assert json.loads(json.dumps(rows, allow_nan=False)) == rows


def test_antennas_that_are_exchanged_are_told_with_what_to_write():
    known = LearntSnapshot(names=LearntNames(antennas={"gnss": "gnss_right", "gnss_right": "gnss"}))
    rows = learnt_rows(known, machine(right=True))
    for name, arm, other in (("gnss", ARM, ARM_RIGHT), ("gnss_right", ARM_RIGHT, ARM)):
        x = next(row for row in rows if row.sensor == name)
        assert (x.configured, x.learnt, x.looks_wrong) == (pytest.approx(arm[0]), pytest.approx(other[0]), True)
        assert json.loads(x.write) == pytest.approx(other, abs=1e-3)
    assert not learnt_rows(known, machine())


def test_exchanged_antennas_are_remembered_until_one_is_mounted_elsewhere(tmp_path):
    known = LearntSnapshot(names=LearntNames(antennas={"gnss": "gnss_right", "gnss_right": "gnss"}))
    save_learnt(tmp_path / "learnt.json", known, machine(right=True))
    assert load_learnt(tmp_path / "learnt.json", machine(right=True)).learnt == known
    config = machine(right=True).model_dump(mode="json")
    config["extrinsics"][0]["translation_m"][0] += 0.1
    assert load_learnt(tmp_path / "learnt.json", Config.model_validate(config)).learnt.names == NAMES_ARE_RIGHT


def test_the_delay_of_a_heading_is_told_with_the_clock_that_it_shares():
    known = {
        "clock of GNSS": LearntConstant(mean=(0.03,), sigmas=(0.003,), is_off=True),
        "heading delay": LearntConstant(mean=(-0.15,), sigmas=(0.004,), is_off=True),
    }
    rows = {row.sensor: row for row in learnt_rows(LearntSnapshot(constants=known), machine(heading=True))}
    assert rows.keys() == {"gnss", "heading"}
    assert (rows["gnss"].write, rows["heading"].write) == ("0.0300", "-0.1200")
    assert rows["heading"].sigma == pytest.approx(0.005)
