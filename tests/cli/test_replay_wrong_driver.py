"""A driver of an IMU gives other signs than the file says: its key is named, and nothing that it taught is kept."""

import sys
from pathlib import Path

import yaml

sys.path += [str(Path(__file__).parents[1] / "replay")]

from small_drive import holdfast, summary

from holdfast.sim.scenario import load_scenario
from holdfast.trial.run import write_simulation


def test_what_a_wrong_driver_taught_is_not_kept(tmp_path):
    write_simulation(load_scenario("rounds", {"duration_s": 60.0}), 0, tmp_path / "drive")
    config, learnt = tmp_path / "drive" / "config.yaml", tmp_path / "learnt.json"
    right = yaml.safe_load(config.read_text(encoding="utf-8"))
    right["sensors"]["imu"]["gyroscope_factors"] = [1.0, 1.0, -1.0]
    config.write_text(yaml.safe_dump(right), encoding="utf-8")
    done = holdfast("replay", tmp_path / "drive", "-c", config, "-o", tmp_path / "out", "--learnt", learnt)
    assert done.code == 0, done.err
    (told,) = summary(tmp_path / "out")["looks_wrong"]  # and no lever arm that explains the wrong sign
    assert told.startswith("sensors.imu.gyroscope_factors looks wrong") and told.endswith("[1, 1, 1]")
    assert f"warning: {learnt}: not written, as keys of the IMU look wrong" in done.err
    assert not learnt.exists()
