"""What is wrong with a recording, found and reported."""

from pathlib import Path

import numpy as np
import pytest
from bags import HUMBLE, START_NS, drive, fix, imu, write_bag

from holdfast.recording.inspection import Inspection, TopicFindings, are_interleaved, inspect
from holdfast.recording.kinds.imu import straight_lines
from holdfast.recording.problems import list_problems
from holdfast.recording.source import open_recording

MS = 1_000_000


def look(tmp_path: Path, rows) -> tuple[dict[str, TopicFindings], list[str], Inspection]:
    with open_recording(write_bag(tmp_path / "b", "mcap", rows)) as recording:
        inspection = inspect(recording)
    return {topic.topic: topic for topic in inspection.topics}, list_problems(inspection), inspection


def noisy(store, stamp, seed=None, **kw):
    noise = np.random.default_rng(stamp % 2**32 if seed is None else seed)
    return imu(store, stamp, rate=noise.normal(size=3), force=noise.normal(size=3), **kw)


def imu_rows(stamps, latency_ns=2 * MS):
    return [("/imu", stamp + latency_ns, noisy(HUMBLE, stamp)) for stamp in stamps]


def test_a_sound_recording_has_no_problems(tmp_path: Path) -> None:
    rows = imu_rows(START_NS + k * 10 * MS for k in range(200))
    rows += [("/gnss/fix", START_NS + k * 100 * MS + 60 * MS, fix(HUMBLE, START_NS + k * 100 * MS)) for k in range(20)]
    topics, problems, inspection = look(tmp_path, rows)
    assert problems == []
    assert inspection.damage is None
    assert topics["/imu"].rate_hz == pytest.approx(100)
    assert topics["/imu"].duration_s == pytest.approx(1.99)
    assert topics["/imu"].latency_mean_s == pytest.approx(0.002)
    assert topics["/imu"].latency_sigma_s == pytest.approx(0, abs=1e-9)
    assert topics["/gnss/fix"].values.statuses == {"gbas": 20}
    assert topics["/gnss/fix"].values.largest_sigma_m == pytest.approx(np.sqrt(0.02))


def test_gaps_are_counted_and_the_longest_is_placed(tmp_path: Path) -> None:
    stamps = [START_NS + k * 10 * MS for k in range(300) if not (50 <= k < 60 or 100 <= k < 200)]
    topics, problems, _ = look(tmp_path, imu_rows(stamps))
    assert topics["/imu"].gaps == 2
    assert topics["/imu"].longest_gap_s == pytest.approx(1.01)
    assert topics["/imu"].longest_gap_at_s == pytest.approx(0.988)
    assert problems == [
        "/imu: 2 gap(s) longer than 5 periods, the longest 1.010 s at 1.0 s; "
        "no IMU factor spans a gap, so the other sensors must bridge it"
    ]


def test_bursts_are_told_as_such_and_are_no_gaps(tmp_path: Path) -> None:
    stamps = [START_NS + k // 10 * 100 * MS + k % 10 * MS // 10 for k in range(300)]
    topics, problems, _ = look(tmp_path, imu_rows(stamps))
    assert topics["/imu"].gaps == 0
    assert topics["/imu"].rate_hz == pytest.approx(100, rel=0.05)
    assert problems == [
        "/imu: the stamps come in bursts of about 10, every 0.099 s: they are times of arrival, not of measurement; "
        "let the driver stamp by the sensor's clock"
    ]


def test_clock_trouble_is_found(tmp_path: Path) -> None:
    stamps = [START_NS + k * 10 * MS for k in range(100)]
    stamps[50] = stamps[40] + 1
    stamps[70] = stamps[69]
    rows = [("/imu", START_NS + k * 10 * MS - (3 * MS if k < 5 else 0), noisy(HUMBLE, s)) for k, s in enumerate(stamps)]
    topics, problems, _ = look(tmp_path, rows)
    findings = topics["/imu"]
    assert (findings.stamps_back, findings.duplicate_stamps, findings.arrived_before_stamp) == (1, 1, 5)
    assert [problem.split(";")[0] for problem in problems] == [
        "/imu: 1 stamp(s) jump back",
        "/imu: 1 stamp(s) occur twice",
        "/imu: 5 of 100 messages arrived before their stamp",
    ]


def test_stamps_of_another_clock_are_found_by_their_latency(tmp_path: Path) -> None:
    _, problems, _ = look(tmp_path, imu_rows((START_NS + k * 10 * MS for k in range(50)), latency_ns=37 * 10**9))
    assert any("stamps are 37.000 s from arrival on average" in problem for problem in problems)


def test_one_arrival_that_no_clock_can_show_spoils_no_other(tmp_path: Path) -> None:
    """An MCAP file keeps times of 64 bits without a sign: beyond 63 bits `info` ended in a traceback."""
    rows = imu_rows(START_NS + k * 10 * MS for k in range(200))
    rows[7] = ("/imu", 2**64 - 1, rows[7][2])
    topics, problems, _ = look(tmp_path, rows)
    assert topics["/imu"].count == 199
    assert topics["/imu"].latency_mean_s == pytest.approx(0.002)
    assert sum("1 message of /imu could not be decoded" in line for line in problems) == 1


def test_an_arrival_in_another_century_is_told(tmp_path: Path) -> None:
    rows = [("/imu", 2**63 - 1, imu_rows([-(2**31) * 10**9])[0][2])]
    topics, _, _ = look(tmp_path, rows)
    assert topics["/imu"].latency_mean_s == pytest.approx((2**63 - 1) * 1e-9 + 2**31)  # 65 bits of nanoseconds


def test_two_frame_ids_on_one_topic_are_a_problem(tmp_path: Path) -> None:
    rows = [
        ("/imu", START_NS + k * 5 * MS, noisy(HUMBLE, START_NS + k * 5 * MS, frame_id=("a", "b")[k % 2]))
        for k in range(50)
    ]
    topics, problems, _ = look(tmp_path, rows)
    assert topics["/imu"].frame_ids == ("a", "b")
    assert any("2 frame_ids ('a', 'b')" in problem for problem in problems)


def test_an_imu_message_without_rates_and_forces_is_judged_as_a_heading(tmp_path: Path) -> None:
    stamps = [START_NS + k * 50 * MS for k in range(100) if not 40 <= k < 80]
    nothing = {"rate": (0.0, 0.0, 0.0), "force": (0.0, 0.0, 0.0)}
    rows = imu_rows(START_NS + k * 10 * MS for k in range(500))
    rows += [("/gnss/heading", stamp + 60 * MS, imu(HUMBLE, stamp, **nothing)) for stamp in stamps]
    topics, problems, _ = look(tmp_path, rows)
    assert topics["/gnss/heading"].kind == "heading"
    assert len(problems) == 1
    assert problems[0].endswith("the gyroscope carries the heading meanwhile")


def test_interleaved_streams_are_told_from_jitter_drop_outs_and_one_jump() -> None:
    even = START_NS + np.arange(500, dtype=np.int64) * 10 * MS
    jitter = np.random.default_rng(1).integers(-MS, MS, 500)
    jump = even.copy()
    jump[250:] -= 3 * 10**9
    for sound in (even, even + jitter, even[np.r_[0:100, 200:500]], jump, even[:3]):
        assert not are_interleaved(sound)
    late = even - 40 * MS
    assert are_interleaved(np.stack([even, late], axis=1).ravel())
    out_of_step = np.sort(np.concatenate([even, even + 3 * MS]))
    assert are_interleaved(out_of_step)


def test_lines_drawn_by_a_logger_repeats_and_nan_are_found(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(300, 6))
    values[100:150] = np.linspace(values[99], values[150], 52)[1:-1]
    values[200] = values[199]
    values[220:224] = values[220]
    values[250, 2] = np.nan
    rows = [
        ("/imu", START_NS + k * 10 * MS, imu(HUMBLE, START_NS + k * 10 * MS, rate=v[:3], force=v[3:]))
        for k, v in enumerate(values)
    ]
    topics, problems, _ = look(tmp_path, rows)
    findings = topics["/imu"].values
    assert (findings.repeats, findings.lines, findings.line_samples, findings.not_finite) == (4, 1, 52, 1)
    assert findings.longest_line_at_s == pytest.approx(0.99)
    assert findings.longest_line_s == pytest.approx(0.51)
    assert any("1 straight line(s) through all six channels, 52 samples" in problem for problem in problems)
    assert any("1 sample(s) are not finite" in problem for problem in problems)


def test_three_samples_on_a_line_are_chance_and_four_are_not() -> None:
    noise = np.random.default_rng(2).normal(size=(20, 6))
    for length, found in ((3, []), (4, [(5, 9)])):
        values = noise.copy()
        values[5 : 5 + length] = np.linspace(np.zeros(6), np.ones(6), length)
        assert straight_lines(values) == found


def test_fixes_without_covariance_and_without_rtk_are_problems(tmp_path: Path) -> None:
    rows = imu_rows(START_NS + k * 10 * MS for k in range(50))
    rows += [("/gnss/fix", START_NS + k * MS, fix(HUMBLE, START_NS + k * MS, status=0, cov_type=0)) for k in range(3)]
    topics, problems, _ = look(tmp_path, rows)
    assert topics["/gnss/fix"].values.smallest_sigma_m is None
    assert any("3 of 3 fixes have no covariance" in problem for problem in problems)
    assert any("no fix has the status gbas (only fix)" in problem for problem in problems)


def test_a_recording_without_an_imu_is_a_problem(tmp_path: Path) -> None:
    _, problems, _ = look(tmp_path, [row for row in drive(HUMBLE, 0.2) if row[0] != "/imu"])
    assert any("no topic has readable sensor_msgs/msg/Imu messages" in problem for problem in problems)
