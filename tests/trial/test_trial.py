"""The truth that a trial is judged by is that of the simulation, in the frames of the estimate."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.config.load import load_config
from holdfast.evaluation import quaternions
from holdfast.recording.tum import read_tum
from holdfast.sim.configuration import configuration
from holdfast.sim.recorder import write_truth
from holdfast.sim.scenario import load_scenario
from holdfast.sim.simulation import START_NS, simulate
from holdfast.trial.run import estimate, judged, write_simulation
from holdfast.trial.truth import truth

PERFECT = {
    **dict.fromkeys(("jitter_m", "jitter_rad"), 0.0),
    **dict.fromkeys(("drift_m_per_sqrt_m", "drift_rad_per_sqrt_m", "drift_rad_per_sqrt_rad"), 0.0),
}
STAMPS = START_NS + np.arange(100, 1900, dtype=np.int64) * 10_000_000


@pytest.fixture(scope="module")
def perfect_lidar():
    scenario = load_scenario("quick", {"sensors": {"lidar": PERFECT}})
    return simulate(scenario, 5), configuration(scenario)


def test_the_truth_is_that_of_the_files(tmp_path: Path, perfect_lidar):
    simulation, config = perfect_lidar
    write_truth(simulation, tmp_path / "truth")
    imu, base = (read_tum(tmp_path / "truth" / f"{name}_in_world.tum") for name in ("imu", "base"))
    rows = np.isin(imu.stamps_ns, STAMPS)
    found = truth(simulation, config, STAMPS)
    np.testing.assert_array_equal(found.states.poses.stamps_ns, imu.stamps_ns[rows])
    np.testing.assert_allclose(found.states.poses.positions, imu.positions[rows], atol=1e-8)
    chassis = found.chassis.in_imu
    at = found.states.poses.positions + quaternions.rotate(found.states.poses.quaternions, chassis.positions)
    np.testing.assert_allclose(at, base.positions[rows], atol=1e-8)


def test_velocities_are_the_derivatives_of_the_positions(perfect_lidar):
    found = truth(*perfect_lidar, STAMPS).states
    central = (found.poses.positions[2:] - found.poses.positions[:-2]) / 0.02
    # the engine shakes the cabin at 28 Hz, of which a difference over 20 ms sees a part: 0.4 m/s^2 / (2 pi 28 Hz)
    np.testing.assert_allclose(found.velocities[1:-1], central, atol=5e-3)


def test_fixes_without_their_errors_lie_at_the_antennas(perfect_lidar):
    simulation, config = perfect_lidar
    for name, fixes in zip(("gnss", "gnss_right"), truth(simulation, config, STAMPS).antennas, strict=True):
        imu = truth(simulation, config, fixes.stamps_ns).states.poses
        antenna = imu.positions + Rotation.from_quat(imu.quaternions).apply(fixes.lever_arm)
        np.testing.assert_allclose(fixes.positions - fixes.errors, antenna, atol=1e-8)
        assert fixes.good.any(), name
        assert not fixes.faulty.any()


def test_a_perfect_lidar_odometry_moves_as_the_imu_does(perfect_lidar):
    found = truth(*perfect_lidar, STAMPS)
    ours, theirs = found.odometry, found.at_odometry
    into_first = quaternions.conjugate(theirs.quaternions[0])
    moved = quaternions.rotate(into_first, theirs.positions - theirs.positions[0])
    back = quaternions.rotate(quaternions.conjugate(ours.quaternions[0]), ours.positions - ours.positions[0])
    np.testing.assert_allclose(back, moved, atol=1e-8)
    assert np.linalg.norm(moved, axis=1).max() > 5.0


def test_fixes_that_a_fault_moved_are_not_good():
    offset = {"kind": "offset", "sensors": ["gnss"], "start_s": 5.0, "end_s": 9.0, "offset_m": [1.0, 0.0, 0.0]}
    scenario = load_scenario("quick", {"faults": [offset]})
    left, right = truth(simulate(scenario, 0), configuration(scenario), STAMPS).antennas
    times_s = (left.stamps_ns - START_NS) * 1e-9
    is_struck = (times_s >= 5.0) & (times_s <= 9.0)
    assert (left.faulty == is_struck).all()
    assert (left.good == ~is_struck).all()
    assert right.good.all()


def test_a_trial_leaves_a_recording_with_its_configuration(tmp_path: Path):
    scenario = load_scenario("quick", {"duration_s": 8})
    simulation = write_simulation(scenario, 2, tmp_path)
    config = load_config(tmp_path / "config.yaml")
    assert config == configuration(scenario)
    trial = judged(simulation, estimate(tmp_path, config))
    assert trial.seed == 2
    assert trial.verdict.scores["started_s"] < 2.0
    assert trial.verdict.scores["horizontal_max_m"] < 0.05  # five sigma of a fix
    assert trial.outcomes["gnss"]["used"] > 50
    assert [kind for _, kind, _, _ in trial.events if kind == "initialised"] == ["initialised"]
