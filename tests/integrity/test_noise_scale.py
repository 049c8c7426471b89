# ruff: noqa: PLR0917 - what is fed is many small choices with defaults
"""How much larger or smaller the noise of a sensor is than it claims, learnt from its innovations."""

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, at, machine, ns
from rig import Rig, position

from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.integrity.noise_scale import HIGHEST, LOWEST, NoiseScale
from holdfast.sensors.noise import FREE_VARIANCE
from holdfast.sensors.sensor import Innovation, Position, State

KNOWN = State(gtsam.NavState(), np.eye(9) * 1e-12)
UNKNOWN = State(gtsam.NavState(), np.eye(9) * 100.0)
H = np.hstack([np.zeros((3, 3)), np.eye(3), np.zeros((3, 3))])


def fed(scale, times, sigma_m, lowest=0.01, state=KNOWN, seed=1, R=None):
    """Let a scale learn from white innovations of `sigma_m`; return what was reported."""
    rng, log = np.random.default_rng(seed), EventLog("imu")
    R = np.eye(3) if R is None else R
    for t in times:
        measured = Position(ns(t), "gnss", np.zeros(3), R, 0.0)
        scale.learn(Innovation(rng.normal(0.0, sigma_m, 3), H, R, np.zeros((3, 0))), state, measured, log, lowest)
    return log.take_events()


def minutes(n, hz=5.0):
    return np.arange(0.0, 60.0 * n, 1.0 / hz)


def test_honest_noise_keeps_its_scale_and_says_nothing():
    scale = NoiseScale()
    assert fed(scale, minutes(5), 1.0) == []
    assert scale.value == pytest.approx(1.0, rel=0.35)


def test_a_measurement_that_says_nothing_teaches_nothing():
    scale = NoiseScale()
    assert fed(scale, minutes(1), 1.0, R=np.eye(3) * FREE_VARIANCE) == [] and scale.value == 1.0


@pytest.mark.parametrize("hz", [1.0, 10.0])
@pytest.mark.parametrize("factor", [0.3, 0.5, 2.0, 4.0])
def test_it_is_found_in_both_directions_whatever_the_rate(factor, hz):
    scale = NoiseScale()
    fed(scale, minutes(4, hz), factor)
    assert scale.ratio == pytest.approx(factor, rel=0.2)
    assert scale.value == pytest.approx(scale.ratio**2, rel=0.01)
    assert scale.above == max(1.0, scale.value)


def test_it_does_not_fall_below_its_bound_and_not_at_all_where_a_claim_is_never_too_large():
    for lowest in (0.01, 0.25, LOWEST):
        scale = NoiseScale()
        fed(scale, minutes(6), 0.001, lowest)
        assert scale.value == pytest.approx(lowest, rel=0.01)


def test_a_claim_that_is_ten_times_too_large_is_found_within_a_minute():
    scale = NoiseScale()
    fed(scale, minutes(1, hz=1.0), 0.1)
    assert scale.ratio == pytest.approx(0.1, abs=0.05)


def test_it_does_not_grow_beyond_its_bound():
    scale = NoiseScale()
    fed(scale, minutes(10), 1000.0)
    assert scale.value == pytest.approx(HIGHEST)


def test_one_measurement_that_is_far_off_tells_little():
    scale = NoiseScale()
    fed(scale, [0.0], 1e6)
    assert scale.value < 1.6


def test_an_excess_that_the_state_explains_is_not_the_sensors():
    scale = NoiseScale()
    fed(scale, minutes(2), 10.0, LOWEST, UNKNOWN)  # 10 m is what the state is unsure by
    assert scale.value == pytest.approx(1.0, abs=0.05)
    fed(scale, minutes(2), 30.0, LOWEST, UNKNOWN)
    assert scale.value < 2.0


@pytest.mark.parametrize("state_m", [0.3, 1.0, 3.0])
def test_honest_noise_keeps_its_scale_beside_a_state_that_is_unsure_too(state_m):
    scale = NoiseScale()
    fed(scale, minutes(5), np.hypot(1.0, state_m), LOWEST, State(gtsam.NavState(), np.eye(9) * state_m**2))
    assert scale.ratio == pytest.approx(1.0, abs=0.3)


def test_a_slow_error_that_the_state_has_too_is_the_sensors_although_the_state_is_unsure():
    """Of 1 m that fix and state share and 0.3 m that they do not, innovations show 0.3 m."""
    scale = NoiseScale()
    fed(scale, minutes(5), 0.3, 0.01, State(gtsam.NavState(), np.eye(9)))
    assert scale.ratio < 0.3


def test_axes_that_nobody_measured_do_not_make_it_fall():
    scale = NoiseScale()
    fed(scale, minutes(4), 1.0, R=np.diag([1.0, 1.0, FREE_VARIANCE]))
    assert scale.value == pytest.approx(1.0, rel=0.4)


def test_what_is_news_is_told_once_per_doubling():
    scale = NoiseScale()
    events = fed(scale, minutes(5), 4.0)
    assert [event.kind for event in events] == [EventKind.NOISE] * 2
    assert events[0].sensor == "gnss"
    assert "times what it claims" in events[0].reason
    assert [event.kind for event in fed(scale, 300.0 + minutes(5), 1.0)] == [EventKind.NOISE] * 2  # and back


# --- where it is used -------------------------------------------------------------------------------------------------

DRIVE = Drive(start_s=-3.0)
LASER = {"kind": "height", "mount": at(ARM), "sigma_m": 0.01, "correlation_s": 0.0}


@pytest.mark.parametrize(("correlation_s", "falls"), [(0.0, False), (10.0, True)])
def test_only_claims_that_hold_a_slow_error_may_be_too_large(correlation_s, falls):
    """They claim 2 m and scatter by centimetres: neighbours are alike, which the correlation says, not the claim."""
    rig = Rig(DRIVE, machine(lidar=False), 90.0)
    for t in np.arange(0.1, 90.0, 0.5):
        one = position(DRIVE, t, ARM, sigma_m=2.0)
        measured = Position(one.stamp_ns, "gnss", one.p_W_P, one.covariance, correlation_s)
        rig.log.count("gnss", rig.positions.add(rig.graph, measured, measured.stamp_ns))
        rig.update()
    assert rig.scales["gnss"].ratio < 0.5 if falls else rig.scales["gnss"].ratio == 1.0


def test_fixes_that_claim_too_little_weigh_less_and_are_not_lost():
    """They claim 2 cm, and are off by 6 cm."""
    sigmas = {}
    for factor in (1.0, 3.0):
        rig, rng = Rig(DRIVE, machine(lidar=False), 60.0), np.random.default_rng(1)
        for t in np.arange(0.1, 60.0, 0.2):
            measured = position(DRIVE, t, ARM, rng.normal(0.0, 0.02 * factor, 3), sigma_m=0.02)
            rig.log.count("gnss", rig.positions.add(rig.graph, measured, measured.stamp_ns))
            rig.update()
        assert rig.positions.lost() == []
        sigmas[factor] = rig.scales["gnss"].ratio
    assert sigmas[1.0] == pytest.approx(1.0, abs=0.3)
    assert 2.0 < sigmas[3.0] < 4.5


def test_what_enters_two_graphs_weighs_the_same_in_both():
    """The scale of the noise was applied once per graph that came before."""
    from holdfast.sensors.height import PointHeight

    rig = Rig(DRIVE, machine(more={"laser": LASER}, graph={"fallback_odometry": "frozen"}), 12.0)
    fed(rig.scales["laser"], minutes(4), 4.0)
    assert rig.scales["laser"].value > 8.0
    rig.graph.main.node(ns(0.5))
    rig.update()
    rig.graph.lose()
    for t in np.arange(0.6, 3.0, 0.1):
        height_m = float(DRIVE.pose(t).transformFrom(ARM)[2])
        measured = PointHeight(ns(t), "laser", height_m, 0.01)
        assert rig.states.add(rig.graph, measured, measured.stamp_ns) is Outcome.USED
        rig.update()
    main, fallback = (np.sqrt(one.newest.covariance[5, 5]) for one in rig.graph.smoothers())
    assert main == pytest.approx(fallback, rel=0.02)
