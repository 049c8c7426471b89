import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.errors import ConfigError
from holdfast.evaluation.absolute import ape, summarise
from holdfast.evaluation.accuracy import Interval, Metrics, evaluate
from holdfast.evaluation.association import Association, associate
from holdfast.evaluation.relative import kitti, rpe
from holdfast.state import Trajectory

SECOND = 1_000_000_000


def line(yaw_drift_deg_per_m=0.0, scale=1.0, count=2001, speed_m_s=1.0):
    """10 Hz along x, with a known drift in scale and yaw."""
    time_s = np.arange(count) * 0.1
    distance = time_s * speed_m_s
    positions = np.stack([distance * scale, np.zeros(count), np.zeros(count)], axis=1)
    yaw = np.radians(yaw_drift_deg_per_m * distance) + 0.2
    return Trajectory(np.arange(count) * (SECOND // 10), positions, Rotation.from_euler("z", yaw[:, None]).as_quat())


def test_every_axis_gets_its_own_signed_error(wander):
    reference = wander()
    errors = ape(associate(replace(reference, positions=reference.positions + np.array([3.0, -4.0, -12.0])), reference))
    for name, value in [("east_m", 3), ("north_m", -4), ("up_m", -12), ("horizontal_m", 5), ("vertical_m", 12)]:
        np.testing.assert_allclose(errors[name], value, atol=1e-12)
    np.testing.assert_allclose(errors["translation_m"], 13.0)
    np.testing.assert_allclose(errors["rotation_deg"], 0.0, atol=1e-12)


def test_roll_pitch_and_yaw_errors_are_differences_of_the_angles():
    angles = np.array([[0.1, -0.2, 3.1], [0.0, 0.3, -3.1]])
    wrong = angles + np.array([0.01, 0.02, 0.1])

    def track(rpy):
        turned = Rotation.from_euler("ZYX", rpy[:, ::-1]).as_quat()
        return Trajectory(np.array([0, SECOND // 10]), np.zeros((2, 3)), turned)

    errors = ape(associate(track(wrong), track(angles)))
    for name, value in [("roll_deg", 0.01), ("pitch_deg", 0.02), ("yaw_deg", 0.1)]:
        np.testing.assert_allclose(errors[name], np.degrees(value), atol=1e-10)


def test_statistics_of_known_numbers():
    result = summarise(np.array([-3.0, 1.0, 1.0, 1.0, np.nan]))
    assert (result.mean, result.median, result.max, result.count) == (0.0, 1.0, 3.0, 4)
    assert result.rms == result.std == pytest.approx(np.sqrt(3.0))
    assert result.p95 == pytest.approx(2.7)
    assert summarise(np.array([np.nan])) is None


def test_a_scale_of_one_percent_is_one_percent_over_any_distance():
    for delta in (1.0, 10.0, 50.0):
        errors = rpe(associate(line(scale=1.01), line()), delta, "m", "consecutive").errors
        np.testing.assert_allclose(errors["translation_percent"], 1.0, rtol=1e-9)
        np.testing.assert_allclose(errors["translation_m"], 0.01 * delta, rtol=1e-9)


def test_yaw_drift_is_told_per_metre_and_per_second():
    pairs = associate(line(yaw_drift_deg_per_m=0.05, speed_m_s=2.0), line(speed_m_s=2.0))
    np.testing.assert_allclose(rpe(pairs, 10.0).errors["rotation_deg_per_m"], 0.05, rtol=1e-9)
    over_time = rpe(pairs, 1.0, "s", "consecutive").errors
    np.testing.assert_allclose(over_time["rotation_deg_per_s"], 0.1, rtol=1e-9)
    np.testing.assert_allclose(over_time["yaw_deg"], 0.1, rtol=1e-9)
    np.testing.assert_allclose(over_time["roll_deg"], 0.0, atol=1e-12)


def test_relative_errors_lie_on_the_axes_of_the_body_at_the_start():
    reference = line()
    turned = Rotation.from_euler("z", np.full((2001, 1), np.pi / 2)).as_quat()
    estimate = replace(line(scale=1.01), quaternions=turned)
    errors = rpe(associate(estimate, replace(reference, quaternions=turned)), 10.0, "m", "consecutive").errors
    np.testing.assert_allclose(errors["left_m"], -0.1, rtol=1e-9)  # the body looks north, the error points east
    np.testing.assert_allclose(errors["forward_m"], 0.0, atol=1e-12)


def test_time_deltas_are_counted_in_nanoseconds():
    result = rpe(associate(line(), line()), 0.3, "s", "consecutive")
    assert set((result.second - result.first).tolist()) == {3}  # 0.1 + 0.2 > 0.3 in floating point


def test_without_orientation_displacements_are_compared():
    pairs = associate(line(scale=1.01), line(), Association(position_only=True))
    errors = rpe(pairs, 10.0, "m", "consecutive").errors
    np.testing.assert_allclose(errors["east_m"], 0.1, rtol=1e-9)
    assert not any(name.startswith("rotation") for name in errors)


def test_percent_of_a_way_that_was_not_driven_is_undefined_and_not_counted():
    still = replace(line(), positions=np.zeros((2001, 3)))
    errors = rpe(associate(replace(still, positions=still.positions + 0.5), still), 1.0, "s").errors
    assert np.isnan(errors["translation_percent"]).all()
    assert summarise(errors["translation_percent"]) is None


@pytest.mark.parametrize("pairing", ["all", "consecutive"])
def test_a_standing_reference_has_no_relative_error_over_distance(pairing):
    still = replace(line(), positions=np.zeros((2001, 3)))
    assert len(rpe(associate(still, still), 10.0, "m", pairing).first) == 0


@pytest.mark.parametrize("pairing", ["all", "consecutive"])
def test_a_delta_below_the_rounding_of_the_way_still_ends(pairing):
    result = rpe(associate(line(), line()), 1e-300, "m", pairing)
    assert (result.second > result.first).all()


@pytest.mark.parametrize(("delta", "unit"), [(0.0, "m"), (-1.0, "s"), (1.5, "frames"), (float("inf"), "s")])
def test_a_delta_that_means_nothing_is_refused(delta, unit):
    with pytest.raises(ConfigError, match="RPE over"):
        rpe(associate(line(), line()), delta, unit)


def test_kitti_segments_start_at_every_tenth_pose_and_end_beyond_their_length():
    pairs = associate(line(scale=1.01), line())
    result = kitti(pairs)
    assert set(np.unique(result.first % 10)) == {0}
    distance = pairs.driven_m()[result.second] - pairs.driven_m()[result.first]
    assert 100.0 < distance[0] <= 100.1 + 1e-9
    lengths = np.concatenate([np.full(100, 100.0), np.full(1, 200.0)])[: len(distance)]
    np.testing.assert_allclose(result.errors["translation_percent"], distance / lengths, rtol=1e-9)


def test_every_interval_gets_every_metric_and_the_error_at_its_end():
    """An outage from 50 s to 60 s in which the estimate drifts 10 cm a second to the north, and is good again after."""
    reference = line()
    time_s = reference.stamps_ns * 1e-9
    drift = np.where((time_s >= 50.0) & (time_s < 60.0), (time_s - 50.0) * 0.1, 0.0)
    estimate = replace(reference, positions=reference.positions + drift[:, None] * [0.0, 1.0, 0.0])
    metrics = Metrics(
        rpe_distances_m=(5.0, 20.0), intervals=(Interval("outage", 50.0, 60.0), Interval("before", 0.0, 50.0))
    )
    scores = evaluate(estimate, reference, metrics=metrics).scores
    assert list(scores) == ["all", "outage", "before"]
    end = scores["outage"].end
    assert end.horizontal_m == pytest.approx(0.99) and end.vertical_m == 0.0 and end.yaw_deg == pytest.approx(0.0)
    assert end.driven_m == pytest.approx(9.9) and end.percent == pytest.approx(10.0)
    assert scores["before"].ape["translation_m"].max == 0.0
    assert scores["outage"].ape["translation_m"].max == scores["all"].ape["translation_m"].max == pytest.approx(0.99)
    assert scores["outage"].rpe["5 m"]["translation_percent"].max == pytest.approx(10.0)
    assert scores["outage"].rpe["20 m"] == {}  # the outage is 9.9 m long


def test_intervals_count_from_the_first_stamp_of_the_reference_not_of_the_pairs():
    reference = line()
    late = Trajectory(reference.stamps_ns[300:], reference.positions[300:], reference.quaternions[300:])
    score = evaluate(late, reference, metrics=Metrics(intervals=(Interval("a", 40.0, 50.0),))).scores["a"]
    assert (score.start_s, score.pairs) == (40.0, 100)
    assert score.end.driven_m == pytest.approx(9.9)


def test_the_verdict_is_valid_json_without_nan():
    verdict = evaluate(line(scale=1.01), line(), "yaw", Metrics(kitti=True, intervals=(Interval("a", 0.0, 0.05),)))
    content = json.loads(json.dumps(verdict.to_json(), allow_nan=False))
    assert content["scores"]["all"]["rpe"]["10 m"]["translation_percent"]["mean"] == pytest.approx(1.0)
    assert content["scores"]["a"]["end"]["percent"] is None


def test_intervals_without_poses_or_with_a_name_twice_are_refused():
    with pytest.raises(ConfigError, match=r"'a' from 300.0 to 400.0 s holds no pose.*0\.000 and 200\.000 s"):
        evaluate(line(), line(), metrics=Metrics(intervals=(Interval("a", 300.0, 400.0),)))
    with pytest.raises(ConfigError, match="twice"):
        evaluate(line(), line(), metrics=Metrics(intervals=(Interval("a", 1.0, 2.0), Interval("a", 3.0, 4.0))))


@pytest.mark.parametrize(
    "wrong", [("a", 2.0, 1.0), ("a", 1.0, 1.0), ("a", float("nan"), 1.0), ("all", 1.0, 2.0), ("", 1.0, 2.0)]
)
def test_intervals_that_mean_nothing_are_refused(wrong):
    with pytest.raises(ConfigError, match="interval"):
        Interval(*wrong)


def test_all_pairs_take_ways_within_ten_percent_of_the_delta():
    pairs = associate(line(), line())
    result = rpe(pairs, 10.0)
    distance = pairs.driven_m()[result.second] - pairs.driven_m()[result.first]
    assert distance.min() == pytest.approx(9.0) and distance.max() == pytest.approx(10.0)
    assert len(distance) == 2001 - 90
