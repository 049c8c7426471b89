"""The messages of a simulation belong to its truth, and to its seed."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from strapdown import integrate

from holdfast.geometry.earth import earth_rate_enu, gravity
from holdfast.sim.motion import Motion
from holdfast.sim.scenario import load_scenario, shipped
from holdfast.sim.sensors.imu import true_signals
from holdfast.sim.simulation import START_NS, Simulation, simulate
from holdfast.sim.terrain import Terrain

CALM = {"engine": {"idle_acceleration_m_s2": 0.0, "work_acceleration_m_s2": 0.0}}


@pytest.fixture(scope="module")
def quick() -> Simulation:
    return simulate(load_scenario("quick"), 1)


@pytest.mark.parametrize(
    ("name", "rate_hz", "overrides"), [("construction", 100, CALM), ("rough", 200, CALM), ("tunnel", 1000, {})]
)
def test_integrating_the_noiseless_imu_for_a_minute_returns_the_true_state(name: str, rate_hz: int, overrides: dict):
    # an engine of 28 Hz cannot be integrated from 100 Hz: sampled as it is, it is switched off there
    scenario = load_scenario(name, overrides)
    motion = Motion(scenario, Terrain(scenario.ground, scenario.objects), 1)
    times_s = 20.0 + np.arange(60 * rate_hz + 1) / rate_hz
    truth = motion.frame("imu", times_s)
    datum = scenario.datum.point
    g, rate = gravity(datum.latitude_deg, datum.altitude_m), earth_rate_enu(datum.latitude_deg)
    rates, forces = true_signals(truth, g, rate)
    R, p, _ = integrate(times_s, rates, forces, truth.R_W_F[0], truth.p_W[0], truth.v_W[0], g, rate)
    assert np.linalg.norm(p[-1] - truth.p_W[-1]) < 0.01
    assert np.degrees(Rotation.from_matrix(R[-1].T @ truth.R_W_F[-1]).magnitude()) < 0.01
    assert np.ptp(truth.p_W[:, :2]) > 1.0


@pytest.mark.parametrize("name", shipped("scenarios"))
def test_no_message_arrives_before_it_was_measured(name: str):
    for sensor, messages in simulate(load_scenario(name), 2).delivered.items():
        measured_ns = START_NS + np.rint(messages.readings.times_s * 1e9).astype(np.int64)
        assert (messages.arrivals_ns >= measured_ns).all(), sensor
        assert len(measured_ns) > 0


def test_both_antennas_and_the_heading_share_the_epochs_of_their_receiver(quick: Simulation):
    stamps = [quick.delivered[name].stamps_ns for name in ("gnss", "gnss_right", "heading")]
    assert np.array_equal(stamps[0], stamps[1])
    assert np.array_equal(stamps[0], stamps[2])


def test_fixes_lie_around_the_true_antenna(quick: Simulation):
    for name in ("gnss", "gnss_right"):
        fixes = quick.delivered[name].readings
        sheet = quick.scenario.sensors[name]
        antenna = quick.motion.frame(sheet.frame, fixes.times_s).p_W
        error = fixes.values["position"] - antenna
        np.testing.assert_allclose(error, fixes.values["error"], atol=1e-12)
        assert 0.003 < error[:, :2].std() < 0.02


def test_a_third_antenna_and_a_second_heading_belong_to_the_same_receiver_and_leave_the_others_alone(quick: Simulation):
    more = {
        "third": {"kind": "gnss", "topic": "/third", "frame": "lidar", "rate_hz": 10},
        "across": {"kind": "heading", "topic": "/a", "frame": "lidar", "rate_hz": 10, "baseline": ["third", "gnss"]},
    }
    simulation = simulate(load_scenario("quick", {"sensors": more}), 1)
    for name, before in quick.delivered.items():
        assert np.array_equal(before.stamps_ns, simulation.delivered[name].stamps_ns), name
    third, across = (simulation.delivered[name].readings for name in more)
    assert np.isin(third.times_s, simulation.delivered["gnss"].readings.times_s).mean() > 0.7
    assert np.std(third.values["position"] - simulation.motion.frame("lidar", third.times_s).p_W) < 0.03
    start, end = (simulation.motion.frame(frame, across.times_s).p_W for frame in ("lidar", "gnss_left"))
    yaw = np.arctan2(*(end - start)[:, 1::-1].T)
    assert np.abs(np.angle(np.exp(1j * (across.values["yaw_rad"] - yaw)))).max() < 0.01


def test_two_odometries_err_independently():
    rear = {"lidar_rear": {"kind": "odometry", "topic": "/rear", "frame": "lidar", "rate_hz": 5}}
    simulation = simulate(load_scenario("quick", {"faults": [], "sensors": rear}), 1)
    first, second = (simulation.delivered[name].readings for name in ("lidar", "lidar_rear"))
    assert len(second.times_s) == 100
    assert not np.array_equal(first.values["position"], second.values["position"])


def test_the_heading_is_that_of_the_baseline(quick: Simulation):
    heading = quick.delivered["heading"].readings
    left, right = (quick.motion.frame(frame, heading.times_s).p_W for frame in ("gnss_left", "gnss_right"))
    yaw = np.arctan2(right[:, 1] - left[:, 1], right[:, 0] - left[:, 0])
    error = np.angle(np.exp(1j * (heading.values["yaw_rad"] - yaw)))
    assert 5e-4 < np.abs(error).mean() < 5e-3


def test_the_outage_of_the_scenario_silences_the_receiver_alone(quick: Simulation):
    for name, messages in quick.delivered.items():
        inside = (messages.readings.times_s > 12.0) & (messages.readings.times_s < 16.0)
        assert inside.any() == (name not in ("gnss", "gnss_right", "heading")), name


def test_another_seed_is_another_machine_and_the_same_seed_the_same(quick: Simulation):
    again, other = simulate(load_scenario("quick"), 1), simulate(load_scenario("quick"), 2)
    for name in ("imu", "gnss", "lidar", "joint"):
        for column, values in quick.delivered[name].readings.values.items():
            assert np.array_equal(values, again.delivered[name].readings.values[column]), (name, column)
        assert np.array_equal(quick.delivered[name].arrivals_ns, again.delivered[name].arrivals_ns)
    assert not np.array_equal(
        quick.delivered["imu"].readings.values["specific_force"],
        other.delivered["imu"].readings.values["specific_force"],
    )


def test_taking_a_sensor_away_changes_no_other(quick: Simulation):
    absent = {"lidar": None, "gnss_right": None, "heading": None}
    whole = simulate(quick.scenario.model_copy(update={"faults": ()}), 1)
    less = simulate(load_scenario("quick", {"faults": [], "sensors": absent}), 1)
    assert absent.keys().isdisjoint(less.delivered)
    for name in ("imu", "gnss", "joint", "base_imu"):
        for column, values in whole.delivered[name].readings.values.items():
            assert np.array_equal(values, less.delivered[name].readings.values[column]), (name, column)


@pytest.mark.slow
def test_the_sky_over_the_navigation_task_is_open_but_for_the_wood():
    fixes = simulate(load_scenario("navigation"), 1).delivered["gnss"].readings
    in_wood = (fixes.times_s >= 220.0) & (fixes.times_s <= 380.0)
    assert (fixes.values["quality"][~in_wood] == 3).all()
    assert (fixes.values["quality"][in_wood] <= 2).mean() > 0.99
    assert (fixes.values["quality"][in_wood] <= 1).mean() > 0.2
