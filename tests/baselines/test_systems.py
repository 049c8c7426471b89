"""The baselines on a small simulated drive: what each can do, and what it cannot."""

import numpy as np
import pytest
from recorded import Recorded, outputs_of

from holdfast.baselines.msf import make_msf
from holdfast.baselines.odometry_alone import make_odometry_alone
from holdfast.baselines.tsif import TSIF_TUNING, make_tsif
from holdfast.errors import ConfigError
from holdfast.events import EventKind, Outcome

SYSTEMS = [make_msf, make_tsif, make_odometry_alone]


def without(config, *names):
    sensors = {name: sensor for name, sensor in config.sensors.items() if name not in names}
    return config.model_copy(update={"sensors": sensors})


@pytest.mark.parametrize("make", [make_msf, make_tsif])
def test_a_filter_publishes_at_every_imu_sample_from_its_start_on(drive, make):
    localiser = make(drive.config)
    estimates, _ = outputs_of(localiser, drive.messages)
    stamps = np.array([estimate.stamp_ns for estimate in estimates])
    assert set(np.diff(stamps).tolist()) == {10_000_000}
    started = [event for event in localiser.events if event.kind is EventKind.INITIALISED]
    assert len(started) == 1
    assert stamps[0] - started[0].stamp_ns == 10_000_000
    assert started[0].stamp_ns - drive.messages[0].stamp_ns < 2_000_000_000  # standstill_s, and the first fixes


@pytest.mark.parametrize("make", SYSTEMS)
def test_the_start_is_that_of_the_truth_within_its_covariance(open_drive, make):
    localiser = make(open_drive.config)
    first = outputs_of(localiser, open_drive.messages[: len(open_drive.messages) // 5])[0][0]
    p, R, v = open_drive.truth_at(first.stamp_ns)
    ours = first.nav.attitude().matrix()
    dR = ours.T @ R
    rotation = 0.5 * np.array([dR[2, 1] - dR[1, 2], dR[0, 2] - dR[2, 0], dR[1, 0] - dR[0, 1]])
    error = np.concatenate([rotation, ours.T @ (p - first.nav.position()), ours.T @ (v - first.nav.velocity())])
    # idling shakes the cabin by a few mm/s, which a single instant of the velocity shows
    sigma = np.sqrt(np.diag(first.covariance)) + np.repeat([0.0, 0.0, 0.01], 3)
    assert (abs(error) < 4.0 * sigma).all()


def test_fixes_hold_both_filters_within_their_noise(open_drive):
    for make in (make_msf, make_tsif):
        estimates, _ = outputs_of(make(open_drive.config), open_drive.messages)
        errors = open_drive.errors(estimates[500:])
        # no worse than single fixes, whose sigma is 8 mm horizontally per axis and 15 mm vertically
        assert np.sqrt((errors[:, :2] ** 2).mean()) < 0.008, make
        assert np.sqrt((errors[:, 2] ** 2).mean()) < 0.015, make


def test_without_gnss_only_the_lidar_holds_the_position(drive):
    start = drive.messages[0].stamp_ns
    worst = {}
    for name, make in (("msf", make_msf), ("tsif", make_tsif)):
        estimates, _ = outputs_of(make(drive.config), drive.messages)
        lost = [e for e in estimates if 12.0 < (e.stamp_ns - start) * 1e-9 < 15.9]
        worst[name] = np.linalg.norm(drive.errors(lost), axis=1).max()
    # the odometry's jitter and drift over some metres are a few centimetres; the IMU alone has nothing to hold it
    assert worst["msf"] < 0.05
    assert worst["tsif"] > worst["msf"]


def test_without_lidar_msf_and_tsif_are_the_same_filter(drive):
    blind = [message for message in drive.messages if message.sensor != "lidar"]
    ours, _ = outputs_of(make_msf(drive.config, TSIF_TUNING), blind)
    theirs, _ = outputs_of(make_tsif(drive.config), blind)
    for a, b in zip(ours[::50], theirs[::50], strict=True):
        sigma = np.sqrt(np.diag(a.covariance)[3:6].max())
        assert np.linalg.norm(a.nav.position() - b.nav.position()) < 0.1 * sigma


def test_tsif_ignores_the_odometry(drive):
    localiser = make_tsif(drive.config)
    outputs_of(localiser, drive.messages)
    lidar = {outcome: count for (sensor, outcome), count in localiser.counts.items() if sensor == "lidar"}
    assert list(lidar) == [Outcome.IGNORED]


def test_a_perfect_odometry_alone_keeps_the_error_of_its_start(open_drive):
    estimates, optimised = outputs_of(make_odometry_alone(open_drive.config), open_drive.messages)
    assert not optimised
    first_p, first_R, _ = open_drive.truth_at(estimates[0].stamp_ns)
    ours = estimates[0].nav.pose()
    for estimate in estimates[1::5]:
        p, R, _ = open_drive.truth_at(estimate.stamp_ns)
        moved = ours.between(estimate.nav.pose())
        np.testing.assert_allclose(moved.translation(), first_R.T @ (p - first_p), atol=1e-6)
        np.testing.assert_allclose(moved.rotation().matrix(), first_R.T @ R, atol=1e-7)


def test_odometry_alone_gives_estimates_at_its_poses_only(open_drive):
    localiser = make_odometry_alone(open_drive.config)
    estimates, _ = outputs_of(localiser, open_drive.messages)
    poses = {m.stamp_ns for m in open_drive.messages if m.sensor == "lidar"}
    assert {estimate.stamp_ns for estimate in estimates} <= poses
    assert len(estimates) == localiser.counts["lidar", Outcome.USED]


@pytest.mark.parametrize("make", SYSTEMS)
def test_a_baseline_that_cannot_start_reports_why(tmp_path, make):
    moving = Recorded(tmp_path, "moving-start", duration_s=4.0)
    localiser = make(moving.config)
    assert outputs_of(localiser, moving.messages)[0] == []
    assert not localiser.initialised
    assert "stood still" in localiser.waiting_for


@pytest.mark.parametrize("make", SYSTEMS)
def test_without_gnss_a_baseline_is_refused(drive, make):
    with pytest.raises(ConfigError, match="none measures a position"):
        make(without(drive.config, "gnss", "gnss_right", "heading"))


def test_without_an_odometry_it_cannot_be_judged_alone(drive):
    with pytest.raises(ConfigError, match="kind: odometry"):
        make_odometry_alone(without(drive.config, "lidar"))


@pytest.mark.parametrize("make", SYSTEMS)
def test_the_same_messages_give_the_same_bits(drive, make):
    once, again = (outputs_of(make(drive.config), drive.messages)[0] for _ in range(2))
    assert all((a.nav.position() == b.nav.position()).all() for a, b in zip(once, again, strict=True))
    assert all((a.covariance == b.covariance).all() for a, b in zip(once, again, strict=True))


@pytest.mark.parametrize("make", [make_msf, make_tsif])
def test_a_silence_of_the_imu_makes_the_position_less_certain(tmp_path, make):
    silence = {"kind": "silence", "sensors": ["imu"], "start_s": 6.0, "end_s": 6.5}
    mute = Recorded(tmp_path, faults=[silence], duration_s=8.0)
    estimates, _ = outputs_of(make(mute.config), mute.messages)
    stamps = np.array([estimate.stamp_ns for estimate in estimates])
    gap = int(np.flatnonzero(np.diff(stamps) > 400_000_000)[0])
    before, after = estimates[gap], estimates[gap + 1]
    assert not after.from_imu
    assert after.covariance[3, 3] > 4.0 * before.covariance[3, 3]
    assert np.linalg.norm(mute.errors([after])) < 5.0 * np.sqrt(after.covariance[3:6, 3:6].trace())


@pytest.mark.parametrize("make", [make_msf, make_tsif])
def test_a_clock_that_goes_back_begins_another_life(tmp_path, make):
    everything = ["imu", "gnss", "gnss_right", "heading", "lidar"]
    step = {"kind": "clock_step", "sensors": everything, "start_s": 4.0, "end_s": 12.0, "step_s": -2.0}
    standing = Recorded(tmp_path, duration_s=9.0, activities=[], faults=[step])
    localiser = make(standing.config)
    estimates, _ = outputs_of(localiser, standing.messages)
    steps = np.diff([estimate.stamp_ns for estimate in estimates])
    assert (steps < 0).sum() == 1
    # what comes before the IMU's new clock is accepted is late, or seen before
    reported = [e.kind for e in localiser.events if e.kind in (EventKind.INITIALISED, EventKind.CLOCK_STEP)]
    assert reported == [EventKind.INITIALISED, EventKind.CLOCK_STEP, EventKind.INITIALISED]
    assert np.linalg.norm(estimates[-1].nav.position() - estimates[100].nav.position()) < 0.05  # noise of fixes


@pytest.mark.parametrize("make", SYSTEMS)
def test_an_idling_engine_does_not_keep_a_baseline_from_starting(tmp_path, make):
    # with this seed the engine shakes the roof by 0.165 m/s^2, more than a zero-velocity update allows
    idling = Recorded(tmp_path, "navigation", seed=2, duration_s=3.0, faults=[])
    localiser = make(idling.config)
    outputs_of(localiser, idling.messages)
    assert localiser.initialised, localiser.waiting_for
