"""From a bag and a track that errs where it returns: the closure that says by how much."""

import numpy as np
import pytest

pytest.importorskip("small_gicp")

from bags import HUMBLE, write_bag
from yard import START_NS, T_W_L, message, standing, sweep

from holdfast.config.load import config_of
from holdfast.covariances import Covariances
from holdfast.loops.opening import loop_closer
from holdfast.recording.source import open_recording
from holdfast.smoothing.block import Track
from holdfast.smoothing.closures import Stretch

OFF_M = np.array([0.12, -0.08, 0.05])  # of the track where it returns
SEEN = [*range(10), *range(100, 110)]  # sweeps, five a second
END_S = 22.0


def config(frame="lidar", **smoothing):
    return config_of(
        {
            "sensors": {
                "imu": {"kind": "imu", "topic": "/imu"},
                "gnss": {"kind": "gnss", "topic": "/gnss"},
                "lidar": {"kind": "odometry", "topic": "/odometry", "frame": frame},
            },
            "extrinsics": [{"parent": "imu", "child": child, "translation_m": [0, 0, 0]} for child in ("gnss", frame)],
            "smoothing": smoothing,
        },
        "the test",
    )


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    rng = np.random.default_rng(0)
    sweeps = [sweep(number, rng, standing) for number in SEEN]
    rows = [("/points", one.stamp_ns + 100_000_000, message(HUMBLE, one)) for one in sweeps]
    return write_bag(tmp_path_factory.mktemp("bag") / "in", "mcap", rows)


def stretch(after_ns=-1):
    """A machine that stands, of which the track says that it has moved by the end."""
    times = START_NS + np.arange(0, round(END_S * 1e9), 10_000_000)
    late = (times - START_NS) > 15e9
    positions = T_W_L(0.0, standing).translation() + late[:, None] * OFF_M
    attitudes = np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1))
    track = Track(times, positions, attitudes, np.zeros_like(positions), np.ones(len(times), dtype=bool))
    nodes = times[::50]
    sigmas = np.where((nodes - START_NS) > 15e9, 0.1, 0.01)
    covariances = np.array([np.diag(np.repeat([0.01, sigma, 0.1], 3) ** 2) for sigma in sigmas])
    return Stretch(track, Covariances(nodes, covariances), after_ns, {})


def closures(bag, of_config, of_stretch):
    with (
        open_recording(bag) as recording,
        loop_closer(bag, recording, of_config, lambda time_ns: time_ns) as closer,
    ):
        return None if closer is None else closer(of_stretch)


def test_the_error_of_the_track_is_found_where_it_returns(bag):
    found = closures(bag, config(), stretch())
    assert found.counts["accepted"] == len(found.closures) >= 1
    for one in found.closures:
        assert one.later_ns - one.earlier_ns >= 15_000_000_000
        assert np.linalg.norm(one.T.translation()) < 0.02  # it stood, whatever the track says
        assert np.linalg.norm(one.T.rotation().rpy()) < 2e-3


def test_what_was_asked_before_is_not_told_again(bag):
    assert not closures(bag, config(), stretch(START_NS + round(END_S * 1e9))).closures


def test_it_can_be_switched_off(bag):
    assert closures(bag, config(loop_closures=False), stretch()) is None


def test_clouds_in_a_frame_that_nothing_joins_to_the_imu_are_counted_and_left_out(bag):
    found = closures(bag, config(frame="other"), stretch())
    assert not found.closures
    assert found.counts["no scans"] >= 1
