"""Holding fixes back: what the estimator sees, and what the errors at the others are."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from small_drive import (
    ARM,
    DATUM,
    EPOCH_NS,
    SECONDS,
    SIGMAS_M,
    config_text,
    events,
    holdfast,
    make_rows,
    poses,
    stamp,
    summary,
    write_config,
    write_csv,
)

from holdfast.config.load import parse_config
from holdfast.errors import ConfigError
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.integrity.learnt_snapshot import LearntSnapshot
from holdfast.messages import FixStatus, GnssFix, PointPosition
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.recording.tum import read_tum
from holdfast.replay.held_out import HeldOutJudge, HoldOut, HoldOutFilter, Judgement
from holdfast.replay.runner import Replay
from holdfast.replay.summary import by_circumstance, held_out_summary
from holdfast.sensors.clock import GNSS_CLOCK
from holdfast.sensors.constants import LearntConstant
from holdfast.state import Estimate

FIXES = round(SECONDS * 5)


@pytest.fixture(scope="module")
def clean_rows():
    """GNSS without noise, so that errors are those of the estimate."""
    return make_rows(gnss_noise=0.0)


@pytest.fixture(scope="module")
def clean_drive(tmp_path_factory, clean_rows):
    return write_csv(tmp_path_factory.mktemp("clean") / "csv", clean_rows)


@pytest.fixture(scope="module")
def config():
    return parse_config(config_text())


def read(folder, config):
    with open_recording(folder) as recording:
        return list(recording.read(subscriptions(config)))


def errors_by_hand(folder, rows):
    """East, north, up errors (N, 3) of the published track at fixes, interpolated to their times, with plain numpy."""
    track = poses(read_tum(folder / "imu_in_world.tum"))
    stamps = np.array(list(track))
    antennas = np.array([T.translation() + T.rotation().matrix() @ ARM for T in track.values()])
    world = LocalFrame(DATUM)
    measured = np.array([world.to_enu(Geodetic(*values[:3])) for _, _, values in rows])
    at = np.array([row[0] for row in rows])
    estimated = [np.interp((at - EPOCH_NS) * 1e-9, (stamps - EPOCH_NS) * 1e-9, antennas[:, k]) for k in range(3)]
    return np.column_stack(estimated) - measured


def assert_errors_are(part, errors):
    """`part` of a summary against errors (N, 3) computed otherwise."""
    horizontal = np.hypot(errors[:, 0], errors[:, 1])
    # linear interpolation of the antenna and that along the arc differ by r (w dt)^2 / 8 < 3e-6 m here
    near = {"rel": 0, "abs": 1e-5}
    assert part["horizontal_m"]["count"] == part["vertical_m"]["count"] == len(errors)
    assert part["horizontal_m"]["rms"] == pytest.approx(np.sqrt(np.mean(horizontal**2)), **near)
    assert part["horizontal_m"]["p95"] == pytest.approx(np.percentile(horizontal, 95), **near)
    assert part["horizontal_m"]["max"] == pytest.approx(horizontal.max(), **near)
    assert part["vertical_m"]["rms"] == pytest.approx(np.sqrt(np.mean(errors[:, 2] ** 2)), **near)
    assert part["vertical_m"]["mean"] == pytest.approx(errors[:, 2].mean(), **near)


def after_start(folder, rows):
    """The rows that the published track covers."""
    track = read_tum(folder / "imu_in_world.tum").stamps_ns
    return [row for row in rows if track[0] < row[0] <= track[-1]]


def test_every_second_fix_judges_and_the_others_are_used(clean_drive, clean_rows, tmp_path):
    done = holdfast(
        "replay", clean_drive, "-c", write_config(tmp_path / "c.yaml"), "-o", tmp_path / "o", "--hold-out", "gnss=2"
    )
    assert done.code == 0, done.err
    result = summary(tmp_path / "o")
    assert sum(result["counts"]["gnss"].values()) == FIXES // 2
    held = after_start(tmp_path / "o", clean_rows.gnss[1::2])
    assert len(held) > 0.35 * FIXES
    part = result["held_out"]["causal"]["all"]
    assert_errors_are(part, errors_by_hand(tmp_path / "o", held))
    # of the right size: better than one fix of 2-3 cm, and not zero as if the fixes were compared with themselves
    assert 1e-4 < part["horizontal_m"]["rms"] < 0.03
    assert "held out, causal" in done.out


def test_errors_during_an_outage_are_those_of_dead_reckoning(clean_drive, clean_rows, tmp_path):
    config = write_config(tmp_path / "c.yaml", lidar=None)
    done = holdfast("replay", clean_drive, "-c", config, "-o", tmp_path / "o", "--outage", "gnss=10:16")
    assert done.code == 0, done.err
    result = summary(tmp_path / "o")
    # seconds count from the first message; every fix of those 6 s is kept back, and no other
    held = [row for row in clean_rows.gnss if stamp(10.0) <= row[0] < stamp(16.0)]
    assert sum(result["counts"]["gnss"].values()) == FIXES - len(held) == FIXES - 30
    errors = errors_by_hand(tmp_path / "o", held)
    assert_errors_are(result["held_out"]["causal"]["outage"], errors)
    assert set(result["held_out"]["causal"]) == {"all", "outage"}
    # IMU alone drifts: the END is worse than the beginning
    horizontal = np.hypot(errors[:, 0], errors[:, 1])
    assert horizontal[-1] > 3 * horizontal[0]


def test_the_last_judgement_of_an_outage_is_its_end_error(clean_drive, clean_rows, config):
    run = Replay(config, None, [HoldOut.parse_outage("gnss=10:16")])
    track = {}
    for message in run._filter.split(read(clean_drive, config)):
        output = run.estimator.process(message)
        run._judge(output)
        if output.estimate is not None:
            track[output.estimate.stamp_ns] = output.estimate.nav.pose()
    end = run.causal.judgements[-1]
    at, _, values = [row for row in clean_rows.gnss if row[0] < stamp(16.0)][-1]
    assert (end.stamp_ns, end.sensor, end.in_outage, end.imu_silent) == (at, "gnss", True, False)
    before, after = max(s for s in track if s < at), min(s for s in track if s >= at)
    fraction = (at - before) / (after - before)
    antennas = [track[s].transformFrom(ARM) for s in (before, after)]
    expected = (1 - fraction) * antennas[0] + fraction * antennas[1] - LocalFrame(DATUM).to_enu(Geodetic(*values[:3]))
    np.testing.assert_allclose(end.error, expected, rtol=0, atol=1e-5)


def test_the_seconds_after_an_outage_are_a_part_of_their_own_for_report_and_demo_alike():
    at_s = {"nominal": [0, 2, 31], "imu_gap": [4, 33], "outage": [6, 10, 16, 20], "recovery": [12, 14, 22, 24, 30]}
    everything = [judged_at(s, part == "outage") for part, seconds in at_s.items() for s in seconds]
    found = by_circumstance(everything, {at * 10**9 for at in (4, 33, 20, 14)})
    assert {part: [one.stamp_ns // 10**9 for one in ones] for part, ones in found.items()} == at_s
    summed = held_out_summary(everything, set())
    assert summed["all"]["horizontal_m"]["count"] == len(everything)
    assert summed["recovery"]["horizontal_m"]["count"] == len(at_s["recovery"])


def judged_at(at_s, in_outage):
    return Judgement(at_s * 10**9, "gnss", in_outage, np.ones(3), 3.0, np.zeros(3), False)


def test_normalised_error_is_near_one_where_the_noise_is_as_claimed(tmp_path):
    drive = write_csv(tmp_path / "csv")
    config = write_config(tmp_path / "c.yaml")
    assert holdfast("replay", drive, "-c", config, "-o", tmp_path / "o", "--hold-out", "gnss=2").code == 0
    part = summary(tmp_path / "o")["held_out"]["causal"]["nominal"]
    dof = 3 * part["horizontal_m"]["count"]
    # NEES of n fixes is chi-square with 3n degrees of freedom: 5 sigma, and the estimate's own error is correlated
    assert abs(part["nees_per_dof"] - 1.0) < 5 * np.sqrt(2 / dof) + 0.1


def test_held_out_and_passed_messages_are_the_stream(clean_drive, config):
    messages = read(clean_drive, config)
    splitter = HoldOutFilter([HoldOut.parse_every("gnss=3"), HoldOut.parse_outage("gnss=10:12")], config)
    passed = list(splitter.split(iter(messages)))
    held = [message for message, _ in splitter.held]
    assert [m for m in messages if m not in held] == passed
    assert all(isinstance(m, GnssFix) for m in held)
    fixes = [m.stamp_ns for m in messages if isinstance(m, GnssFix)]
    cut = [at for at in fixes if stamp(10) <= at < stamp(12)]
    others = [at for at in fixes if at not in cut]
    assert [m.stamp_ns for m in held] == sorted(cut + others[2::3])
    # every third of the others: the first after the outage is one of them, and an outage lasts until a fix is passed
    assert others[50] == stamp(12.004)
    assert [m.stamp_ns for m, in_outage in splitter.held if in_outage] == [*cut, others[50]]


def test_unusable_fixes_are_not_held_out(clean_rows, tmp_path):
    bad = [
        (at, arrival, (*values[:3], -1, *values[4:])) if k % 2 else (at, arrival, values)
        for k, (at, arrival, values) in enumerate(clean_rows.gnss)
    ]
    drive = write_csv(tmp_path / "csv", replace(clean_rows, gnss=bad))
    config = write_config(tmp_path / "c.yaml")
    assert holdfast("replay", drive, "-c", config, "-o", tmp_path / "o", "--hold-out", "gnss=2").code == 0
    result = summary(tmp_path / "o")
    assert result["counts"]["gnss"]["low_status"] == FIXES // 2  # all of them reach the estimator, which refuses them
    assert sum(result["counts"]["gnss"].values()) == FIXES // 2 + FIXES // 4
    held = after_start(tmp_path / "o", clean_rows.gnss[2::4])
    assert_errors_are(result["held_out"]["causal"]["all"], errors_by_hand(tmp_path / "o", held))


def test_outage_takes_unusable_fixes_no_more_than_usable_ones_are_missed(clean_rows, tmp_path):
    bad = [
        (at, arrival, (*v[:3], -1, *v[4:])) if k == 60 else (at, arrival, v)
        for k, (at, arrival, v) in enumerate(clean_rows.gnss)
    ]
    drive = write_csv(tmp_path / "csv", replace(clean_rows, gnss=bad))
    config = write_config(tmp_path / "c.yaml")
    assert holdfast("replay", drive, "-c", config, "-o", tmp_path / "o", "--outage", "gnss=11.9:13").code == 0
    result = summary(tmp_path / "o")
    assert result["counts"]["gnss"]["low_status"] == 1
    assert [e["reason"] for e in events(tmp_path / "o") if e["kind"] == "rejected"] == ["low_status"]
    assert result["held_out"]["causal"]["outage"]["horizontal_m"]["count"] == 4


def test_smoothed_track_is_judged_by_the_same_fixes(clean_drive, tmp_path):
    config = write_config(tmp_path / "c.yaml")
    assert holdfast("replay", clean_drive, "-c", config, "-o", tmp_path / "o", "--outage", "gnss=8:12").code == 0
    result = summary(tmp_path / "o")["held_out"]
    assert result["smoothed"]["outage"]["horizontal_m"]["count"] == 20
    assert result["smoothed"]["outage"]["horizontal_m"]["max"] < SIGMAS_M[1]  # fixes on both sides, lidar between
    assert result["smoothed"]["outage"]["nees_per_dof"] is None  # its nodes have left with their covariance


def test_a_held_out_prism_judges_through_its_lever_arm_and_its_latency():
    config = parse_config(
        """
sensors:
  imu: {kind: imu, topic: imu}
  mast: {kind: prism, topic: mast, latency_s: 0.1, grid_position_m: [100, 0, 0], grid_yaw_deg: 90, sigma_m: 0.01}
extrinsics:
  - {parent: imu, child: mast, translation_m: [0, 0, 2]}
"""
    )
    messages = [
        PointPosition(stamp(t + 0.1), stamp(t + 0.2), "mast", np.array([2 * t, 0.0, 5.0]), None) for t in (1, 2)
    ]
    splitter = HoldOutFilter([HoldOut.parse_every("mast=2")], config)
    assert list(splitter.split(messages)) == messages[:1]
    judge = HeldOutJudge(config)
    judge.add_message(*splitter.held[0])
    for t in (1.9, 2.1):  # the machine goes north at 2 m/s, 1 m beside the prism's track and 3 m below it
        nav = gtsam.NavState(gtsam.Rot3.Yaw(np.pi / 2), np.array([101.0, 2 * t, 3.0]), np.zeros(3))
        estimate = Estimate.of(
            stamp(t), nav, gtsam.Pose3(), gtsam.imuBias.ConstantBias(), np.eye(9) * 1e-4, np.zeros(3), True
        )
        judge.add_estimate(estimate, None)
    (judged,) = judge.judgements
    assert (judged.stamp_ns, judged.sensor, judged.in_outage) == (stamp(2.0), "mast", False)
    np.testing.assert_allclose(judged.position, [100.0, 4.0, 5.0], atol=1e-9)
    np.testing.assert_allclose(judged.error, [1.0, 0.0, 0.0], atol=1e-6)
    # east of W is across the mast: its tilt adds 4 times the rotation's variance
    assert judged.nees == pytest.approx(1.0 / (1e-4 + 4e-4 + 1e-4), rel=1e-6)


def test_a_fix_cannot_judge_a_world_without_a_datum(config):
    judge = HeldOutJudge(config)
    fix = GnssFix(stamp(1.0), stamp(1.1), "gnss", *DATUM, np.eye(3), FixStatus.GBAS)
    judge.add_message(fix, False)
    for t in (0.9, 1.1):
        judge.add_smoothed(stamp(t), gtsam.NavState(), None)
    assert judge.judgements == []


class Learnt:
    """An estimator that has found a clock that is off, or may be right after all."""

    def __init__(self, is_off: bool) -> None:
        self._clock = LearntConstant(mean=(0.04,), sigmas=(0.002,), is_off=is_off)

    def noise(self, _sensor: str) -> float:
        return 1.0

    def learnt(self) -> LearntSnapshot:
        return LearntSnapshot(constants={GNSS_CLOCK: self._clock})


@pytest.mark.parametrize(("is_off", "error_m"), [(True, 0.0), (False, -0.4)])
def test_a_fix_judges_the_track_at_the_time_that_the_clock_of_its_receiver_was_found_to_mean(config, is_off, error_m):
    judge, frame = HeldOutJudge(config, Learnt(is_off)), LocalFrame(Geodetic(*DATUM))
    at = frame.to_geodetic(np.array([10.4, 0.0, 0.0]) + ARM)
    judge.add_message(GnssFix(stamp(1.0), stamp(1.1), "gnss", *at, np.eye(3), FixStatus.GBAS), False)
    for t in (0.9, 1.0, 1.02, 1.1):  # 10 m/s east
        judge.add_smoothed(stamp(t), gtsam.NavState(gtsam.Rot3(), np.array([10.0 * t, 0.0, 0.0]), np.zeros(3)), frame)
    (judged,) = judge.judgements
    assert judged.stamp_ns == stamp(1.0)
    np.testing.assert_allclose(judged.error, [error_m, 0.0, 0.0], atol=1e-6)


def test_a_fix_before_the_first_estimate_is_in_no_gap_of_the_imu(config):
    """The nodes of the start are not from the IMU: a fix among them was told as one in a drop-out."""
    judge, frame = HeldOutJudge(config), LocalFrame(Geodetic(*DATUM))
    at = frame.to_geodetic(ARM)
    for t in (0.95, 1.05, 1.15, 1.25):
        judge.add_message(GnssFix(stamp(t), stamp(t), "gnss", *at, np.eye(3), FixStatus.GBAS), False)
    # two nodes of the start, two estimates at the IMU, and a node where the IMU is silent
    for t, from_imu in ((0.9, False), (1.0, False), (1.1, True), (1.2, True), (1.3, False)):
        estimate = Estimate.of(
            stamp(t), gtsam.NavState(), gtsam.Pose3(), gtsam.imuBias.ConstantBias(), np.eye(9), np.zeros(3), from_imu
        )
        judge.add_estimate(estimate, frame)
    assert [one.imu_silent for one in judge.judgements] == [False, False, False, True]


def test_without_hold_out_nothing_is_judged(replayed):
    assert summary(replayed)["held_out"] == {"causal": None, "smoothed": None}


@pytest.mark.parametrize("text", ["", "gnss", "gnss=", "=2", "gnss=1", "gnss=0", "gnss=-2", "gnss=2.5", "gnss=two"])
def test_hold_out_must_be_a_sensor_and_a_number_above_one(text):
    with pytest.raises(ConfigError, match=r"must be SENSOR=N with N >= 2, such as gnss=2"):
        HoldOut.parse_every(text)


@pytest.mark.parametrize(
    "text", ["", "gnss", "gnss=", "gnss=5", "gnss=1:2:3", "gnss=a:b", "gnss=5:5", "gnss=-1:5", "gnss=6:5", "gnss=nan:5"]
)
def test_outage_must_be_a_sensor_and_a_span(text):
    with pytest.raises(ConfigError, match=r"--outage .*must (be SENSOR=START:END|start at 0 s or later)"):
        HoldOut.parse_outage(text)
