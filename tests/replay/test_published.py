"""What the recorder keeps is what the estimator published, split where the estimator starts over."""

import numpy as np

from holdfast.config.load import parse_config, resolved_yaml
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.published import PublishedRecorder
from holdfast.sim.configuration import configuration
from holdfast.sim.recorder import write_recording
from holdfast.sim.scenario import load_scenario
from holdfast.sim.simulation import START_NS, simulate

STANDING = {"duration_s": 8, "activities": [], "faults": []}


def recorded(folder, **changes):
    scenario = load_scenario("quick", STANDING | changes)
    write_recording(simulate(scenario, 1), folder / "recording.mcap", False, None)
    recorder = PublishedRecorder(parse_config(resolved_yaml(configuration(scenario), given_only=True)))
    with open_recording(folder / "recording.mcap") as recording:
        recorder.run(recording.read(subscriptions(recorder.estimator.config)))
    return recorder


def test_a_standing_machine_is_published_at_imu_rate_and_does_not_accelerate(tmp_path):
    published = recorded(tmp_path).published()
    stamps = published.world.poses.stamps_ns
    assert set(np.diff(stamps).tolist()) == {10_000_000}
    assert len(stamps) > 600
    assert published.inertial.received[1:].all()
    assert not published.inertial.received[0]
    # vibration of the idling engine is 0.08 m/s^2 per axis; gravity would be 9.8
    assert np.abs(published.inertial.acceleration.mean(axis=0)).max() < 0.02
    assert np.abs(published.inertial.acceleration).max() < 0.5
    assert published.trusted.all()


def test_without_gnss_nothing_is_trusted_until_it_is_used_again(tmp_path):
    outage = {"kind": "outage", "sensors": ["gnss", "gnss_right", "heading"], "start_s": 3.0, "end_s": 6.0}
    published = recorded(tmp_path, faults=[outage]).published()
    times_s = (published.world.poses.stamps_ns - START_NS) * 1e-9
    assert published.trusted[times_s < 3.0].all()
    assert not published.trusted[(times_s > 5.0) & (times_s < 6.0)].any()
    assert published.trusted[-1]


def test_a_clock_that_goes_back_begins_another_life(tmp_path):
    everything = ["imu", "gnss", "gnss_right", "heading", "lidar"]
    step = {"kind": "clock_step", "sensors": everything, "start_s": 4.0, "end_s": 12.0, "step_s": -2.0}
    recorder = recorded(tmp_path, duration_s=12, faults=[step])
    first, second = recorder.lives()
    assert second.world.poses.stamps_ns[0] < first.world.poses.stamps_ns[-1]
    assert not second.inertial.received[0]
    stamps = recorder.published().world.poses.stamps_ns
    assert (np.diff(stamps) > 0).all()
    assert len(stamps) < len(first.world.poses.stamps_ns) + len(second.world.poses.stamps_ns)


def test_a_drop_out_of_the_imu_is_marked_as_not_received(tmp_path):
    silence = {"kind": "silence", "sensors": ["imu"], "start_s": 4.0, "end_s": 4.5}
    published = recorded(tmp_path, faults=[silence]).published()
    dumb = np.flatnonzero(~published.inertial.received)[1:]
    times_s = (published.world.poses.stamps_ns[dumb] - START_NS) * 1e-9
    assert len(dumb) >= 1
    assert ((times_s > 4.4) & (times_s < 4.6)).all()


def test_an_estimator_that_never_started_published_nothing(tmp_path):
    recorder = recorded(
        tmp_path, duration_s=1.1, sensors={"lidar": None, "gnss": None, "gnss_right": None, "heading": None}
    )
    assert recorder.lives() == []
    assert len(recorder.published().world.poses.stamps_ns) == 0
