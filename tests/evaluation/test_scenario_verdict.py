"""The verdict on a made-up run whose errors are known: what is good, what is an outage, and what each score says."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.errors import EstimatorError
from holdfast.evaluation.evidence import Chassis, Fixes, Published, Truth
from holdfast.evaluation.scenario import judge
from holdfast.evaluation.smoothness import Inertial
from holdfast.evaluation.soundness import violations
from holdfast.evaluation.states import States
from holdfast.state import Trajectory

START = 1_600_000_000_000_000_000
DURATION_S, RATE_HZ = 60.0, 100.0
OUTAGE = (20.0, 30.0)
ARM = np.array([-1.0, 0.5, 2.0])
TIMES = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)


def drive(times_s):
    """A circle of 20 m at 1 m/s: poses and velocities."""
    angle = times_s / 20.0
    positions = 20.0 * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    velocities = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
    quaternions = Rotation.from_euler("z", (angle + np.pi / 2)[:, None]).as_quat()
    return Trajectory(START + np.rint(times_s * 1e9).astype(np.int64), positions, quaternions), velocities


def fixes(good, faulty=None, error=(0.01, 0.0, 0.02)):
    times = np.arange(0.01, DURATION_S, 0.05)
    poses, _ = drive(times)
    errors = np.tile(error, (len(times), 1)) * np.where(np.arange(len(times)) % 2, 1.0, -1.0)[:, None]
    at = poses.positions + Rotation.from_quat(poses.quaternions).apply(ARM)
    is_faulty = np.zeros(len(times), dtype=bool) if faulty is None else faulty(times)
    return Fixes(poses.stamps_ns, at + errors, errors, good(times) & ~is_faulty, is_faulty, ARM)


def outside(start_s=OUTAGE[0], end_s=OUTAGE[1]):
    return lambda times: (times < start_s) | (times >= end_s)


def evidence(position=None, *, yaw=None, trusted=None, velocity=None, antennas=None, odometry_drift=0.0):
    """Return what was published, wrong by position (N, 3) [m], yaw (N,) [rad], velocity (N, 3), and the truth."""
    n = len(TIMES)
    poses, velocities = drive(TIMES)
    p = np.zeros((n, 3)) if position is None else position
    turned = Rotation.from_euler("z", (np.zeros(n) if yaw is None else yaw)[:, None])
    quaternions = (turned * Rotation.from_quat(poses.quaternions)).as_quat()
    world = States(
        Trajectory(poses.stamps_ns, poses.positions + p, quaternions),
        velocities + (0.0 if velocity is None else velocity),
    )
    rates = np.tile([0.0, 0.0, 1.0 / 20.0], (n, 1))
    received = np.arange(n) > 0
    odometry_poses, _ = drive(np.arange(0.1, DURATION_S, 0.2))
    since = np.maximum(np.arange(0.1, DURATION_S, 0.2) - OUTAGE[0], 0.0)
    odometry = replace(
        odometry_poses, positions=odometry_poses.positions + odometry_drift * since[:, None] * [1.0, 0.0, 0.0]
    )
    chassis = Chassis(replace(poses, positions=np.zeros((n, 3))), rates[:, 2])
    published = Published(
        world=world,
        odometry=States(poses, velocities),
        covariances=np.tile(np.diag([1e-3] * 3 + [0.01] * 3 + [0.02] * 3) ** 2, (n, 1, 1)),
        inertial=Inertial(rates, -poses.positions / 400.0, received, np.zeros((n, 3))),
        trusted=np.ones(n, dtype=bool) if trusted is None else trusted,
        chassis=chassis,
    )
    truth = Truth(
        start_ns=START,
        states=States(poses, velocities),
        antennas=[fixes(outside())] if antennas is None else antennas,
        odometry=odometry,
        at_odometry=odometry_poses,
        chassis=chassis,
        slewing=TIMES > 40.0,
    )
    return published, truth


def constant(*vector):
    return np.tile(vector, (len(TIMES), 1))


def between(start_s, end_s):
    return ~outside(start_s, end_s)(TIMES)


def test_a_perfect_run_has_no_error_and_no_step():
    verdict = judge(*evidence())
    for key in ("horizontal_rms_m", "vertical_rms_m", "outage_horizontal_rms_m", "settled_s", "regained_s", "misled_s"):
        assert verdict.scores[key] == 0.0
    assert verdict.scores["heading_rms_deg"] == pytest.approx(0.0, abs=1e-6)
    assert verdict.scores["step_m"] < 1e-6
    assert verdict.scores["base_rotation_rms_deg"] == pytest.approx(0.0, abs=1e-6)


def test_an_outage_is_where_no_antenna_has_a_good_fix():
    (outage,) = judge(*evidence()).outages
    assert outage.span == pytest.approx(OUTAGE, abs=0.06)
    assert not outage.has_faulty
    left, right = fixes(outside(20.0, 30.0)), fixes(outside(25.0, 35.0))
    (shared,) = judge(*evidence(antennas=[left, right])).outages
    assert shared.span == pytest.approx((25.0, 30.0), abs=0.06)


def test_a_run_without_an_outage_has_no_scores_of_outages():
    verdict = judge(*evidence(antennas=[fixes(outside(70.0, 80.0))]))
    assert verdict.outages == ()
    for key in ("outage_horizontal_rms_m", "settled_s", "regained_s", "fallback_nees_position"):
        assert np.isnan(verdict.scores[key])
    assert verdict.scores["horizontal_rms_m"] == 0.0


def test_a_run_without_gnss_is_one_outage_without_a_recovery():
    (outage,) = judge(*evidence(antennas=[])).outages
    assert outage.span == (TIMES[0], TIMES[-1])
    assert np.isnan(outage.settled_s)


def test_fixes_that_lie_are_an_outage_whatever_they_claim():
    faulty_antenna = fixes(outside(70.0, 80.0), faulty=lambda times: (times > 40.0) & (times < 45.0))
    (outage,) = judge(*evidence(antennas=[faulty_antenna])).outages
    assert outage.has_faulty
    assert outage.span == pytest.approx((40.0, 45.0), abs=0.06)


def test_errors_of_the_outage_and_of_the_recovery_are_not_those_of_good_gnss():
    error = constant(0.003, 0.004, 0.012)
    error[between(19.955, 35.0)] = [3.0, 4.0, 5.0]  # the last good fix is that of 19.96 s
    scores = judge(*evidence(error)).scores
    assert scores["horizontal_rms_m"] == pytest.approx(0.005)
    assert scores["vertical_rms_m"] == pytest.approx(0.012)
    assert scores["outage_horizontal_rms_m"] == pytest.approx(5.0)
    assert scores["outage_vertical_rms_m"] == pytest.approx(5.0)


def test_the_ratio_is_to_the_errors_of_the_fixes_themselves():
    scores = judge(*evidence(constant(0.003, 0.004, 0.012))).scores
    assert scores["fix_horizontal_rms_m"] == pytest.approx(0.01)
    assert scores["horizontal_ratio"] == pytest.approx(0.5)
    assert scores["vertical_ratio"] == pytest.approx(0.6)


def test_against_rtk_the_mean_is_signed_and_the_deviation_is_of_all_axes():
    scores = judge(*evidence(constant(0.0, 0.006, 0.008))).scores
    assert scores["rtk_mean_m"] == pytest.approx(
        0.01, rel=0.01
    )  # as many fixes are wrong in one direction as in the other
    assert scores["rtk_std_m"] == pytest.approx(np.sqrt((0.01**2 + 0.02**2) / 3.0), rel=0.01)


def test_a_turn_moves_the_antenna_by_its_lever_arm():
    scores = judge(*evidence(yaw=np.full(len(TIMES), 0.01))).scores
    assert scores["heading_rms_deg"] == pytest.approx(np.degrees(0.01))
    assert scores["roll_pitch_rms_deg"] == pytest.approx(0.0, abs=1e-6)
    quarter = 0.01 * np.hypot(1.0, 0.5)  # the mean over a part of the circle is shorter
    assert 0.5 * quarter < np.hypot(scores["rtk_mean_m"], scores["rtk_std_m"]) < 2.0 * quarter


def test_odometry_alone_begins_at_the_truth_at_the_loss():
    scores = judge(*evidence(constant(0.2, 0.0, 0.0), odometry_drift=0.03)).scores
    # 0.03 m/s over 10 s: RMS 0.3 / sqrt(3), from the last scan before the loss on
    assert scores["outage_alone_horizontal_rms_m"] == pytest.approx(0.3 / np.sqrt(3.0), rel=0.02)
    assert scores["outage_horizontal_excess_m"] == pytest.approx(0.2 - 0.3 / np.sqrt(3.0), abs=0.004)


def test_recovery_lasts_until_the_error_stays_small_and_until_gnss_is_used():
    error = constant(0.0, 0.0, 0.0)
    error[between(20.0, 31.5)] = [0.05, 0.0, 0.0]
    error[between(31.8, 32.0)] = [0.03, 0.0, 0.0]  # small for 0.3 s in between
    (outage,) = judge(*evidence(error, trusted=~between(21.0, 30.5))).outages
    assert outage.regained_s == pytest.approx(0.5, abs=0.03)
    assert outage.settled_s == pytest.approx(1.5, abs=0.03)  # from there on


def test_an_error_that_was_small_when_gnss_came_back_has_settled_at_once():
    (outage,) = judge(*evidence(constant(0.0, 0.0, 0.0), trusted=~between(21.0, 33.0))).outages
    assert outage.regained_s == pytest.approx(3.0, abs=0.03)
    assert outage.settled_s == 0.0


def test_gnss_that_is_never_used_again_is_reported():
    (outage,) = judge(*evidence(trusted=TIMES < 21.0)).outages
    assert outage.regained_s == np.inf


def test_being_misled_is_being_far_off_while_trusting():
    error = constant(0.0, 0.0, 0.0)
    error[between(22.0, 26.0)] = [0.31, 0.0, 0.0]
    assert judge(*evidence(error)).scores["misled_s"] == pytest.approx(4.0)
    assert judge(*evidence(error, trusted=~between(23.0, 30.0))).scores["misled_s"] == pytest.approx(1.0)


@pytest.mark.parametrize("modesty", [0.5, 1.0, 3.0])
def test_nees_tells_honest_covariances_from_others_in_good_times_and_in_outages(modesty):
    noise = np.random.default_rng(3).standard_normal((3, len(TIMES), 3))
    published, truth = evidence(0.01 * noise[0], yaw=1e-3 * noise[1][:, 0], velocity=0.02 * noise[2])
    published = replace(published, covariances=published.covariances * modesty)
    scores = judge(published, truth).scores
    for prefix in ("nees", "fallback_nees"):  # at least 1000 samples of 3: a deviation of 0.026
        assert scores[f"{prefix}_position"] == pytest.approx(1.0 / modesty, rel=0.15)
        assert scores[f"{prefix}_velocity"] == pytest.approx(1.0 / modesty, rel=0.15)
        assert scores[f"{prefix}_attitude"] == pytest.approx(1.0 / (3.0 * modesty), rel=0.15)  # yaw alone is wrong


def test_a_covariance_that_is_none_is_infinitely_inconsistent():
    published, truth = evidence()
    published.covariances[5000] = 0.0
    assert judge(published, truth).scores["nees_position"] == np.inf


def test_the_chassis_is_judged_beside_the_cabin_while_it_slews():
    published, truth = evidence(constant(1.0, 0.0, 0.0))
    ours = published.chassis.in_imu
    shift = np.where(truth.slewing[:, None], [0.0, 0.03, 0.04], [9.0, 9.0, 9.0])
    chassis = Chassis(replace(ours, positions=ours.positions + shift), published.chassis.yaw_rate + 0.004)
    scores = judge(replace(published, chassis=chassis), truth).scores
    assert scores["base_position_rms_m"] == pytest.approx(0.05)
    assert scores["base_yaw_rate_rms_rad_s"] == pytest.approx(0.004)


def test_a_run_in_which_nothing_was_published_is_refused():
    published, truth = evidence()
    empty = replace(published.world, poses=Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 4))))
    with pytest.raises(EstimatorError, match="nothing was published"):
        judge(replace(published, world=empty), truth)


# --- soundness -------------------------------------------------------------------------------------------------------


def test_a_sound_run_breaks_nothing():
    published, _ = evidence()
    assert list(violations(published, START)) == []


@pytest.mark.parametrize("name", ["positions", "quaternions"])
def test_a_pose_that_is_no_number_is_found(name):
    published, _ = evidence()
    getattr(published.world.poses, name)[1234, 0] = np.nan
    (found,) = violations(published, START)
    assert "is not finite at 12.34 s, in 1 estimates" in found


def test_a_covariance_that_is_no_number_or_not_positive_is_found():
    published, _ = evidence()
    published.covariances[700, 3, 3] = np.inf
    assert [line.split(" at ")[0] for line in violations(published, START)] == ["covariance is not finite"]
    published.covariances[700] = -np.eye(9)
    assert list(violations(published, START)) == ["the covariance is not positive at 7.00 s, in 1 estimates"]


def test_a_covariance_is_positive_whatever_the_units_of_its_rows():
    """Attitudes that moved the state by 300 km: the rounding of the largest eigenvalue is more than the smallest.

    Which of them it turns negative depends on the processor.
    """
    published, _ = evidence()
    rng, rows = np.random.default_rng(4), slice(700, 740)
    for row in range(rows.start, rows.stop):
        root = np.diag([0.4] * 3 + [1.0] * 6)
        root[3:6, :3] = root[6:, :3] = 3e5 * rng.uniform(-3.0, 3.0, (3, 3))
        published.covariances[row] = root @ root.T
    assert (np.linalg.eigvalsh(published.covariances[rows])[:, 0] < 0.0).any()
    assert list(violations(published, START)) == []


@pytest.mark.parametrize(("size", "found"), [(0.0019, 0), (0.0021, 1)])
def test_two_millimetres_are_the_bound_of_the_odometry_frame(size, found):
    published, _ = evidence()
    published.odometry.poses.positions[3000:] += [size, 0.0, 0.0]
    lines = list(violations(published, START))
    assert len(lines) == found
    assert all("O steps by up to 2.1 mm at 30.00 s" in line for line in lines)


@pytest.mark.parametrize(("size_deg", "found"), [(0.019, 0), (0.021, 1)])
def test_a_fiftieth_of_a_degree_is_the_bound_of_the_odometry_frame(size_deg, found):
    published, _ = evidence()
    q = published.odometry.poses.quaternions
    q[3000:] = (Rotation.from_euler("z", size_deg, degrees=True) * Rotation.from_quat(q[3000:])).as_quat()
    lines = list(violations(published, START))
    assert len(lines) == found
    assert all("O steps by up to 0.021 deg at 30.00 s" in line for line in lines)


@pytest.mark.parametrize(("learnt_deg_s", "found"), [(0.0, 1), (0.1, 1), (0.3, 0)])
def test_a_step_may_be_larger_by_half_of_what_was_learnt_of_the_bias_meanwhile(learnt_deg_s, found):
    """0.3 deg/s over 10 ms are 0.003 deg."""
    published, _ = evidence()
    q = published.odometry.poses.quaternions
    q[3000:] = (Rotation.from_euler("z", 0.021, degrees=True) * Rotation.from_quat(q[3000:])).as_quat()
    published.inertial.gyroscope_bias[3000:, 2] = np.radians(learnt_deg_s)
    assert len(list(violations(published, START))) == found


def test_stamps_that_go_back_are_found():
    published, _ = evidence()
    published.world.poses.stamps_ns[500:] -= 10_000_000
    assert list(violations(published, START)) == ["the stamps do not increase at 4.99 s"]


@pytest.mark.parametrize(("size_deg", "found"), [(0.0249, 0), (0.026, 1)])
def test_over_lost_samples_corrections_may_flow_as_fast_as_at_any_time(size_deg, found):
    """Half a degree a second: 0.025 deg in the 50 ms without samples, and no step at its rate."""
    published, _ = evidence()
    q = published.odometry.poses.quaternions
    q[3000:] = (Rotation.from_euler("z", size_deg, degrees=True) * Rotation.from_quat(q[3000:])).as_quat()
    kept = np.delete(np.arange(len(TIMES)), np.arange(2996, 3000))
    assert len(list(violations(rows(published, kept), START))) == found


def rows(published, kept):
    """Return some of the estimates."""
    states = [
        States(Trajectory(*(getattr(one.poses, name)[kept] for name in ("stamps_ns", "positions", "quaternions"))), v)
        for one in (published.world, published.odometry)
        for v in [one.velocities[kept]]
    ]
    one = published.inertial
    inertial = Inertial(*(getattr(one, field.name)[kept] for field in fields(one)))
    return Published(*states, published.covariances[kept], inertial, published.trusted[kept])
