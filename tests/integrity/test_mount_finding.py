"""How an odometry is mounted, from how it and the machine moved."""

import gtsam
import numpy as np
import pytest

from holdfast.integrity.mount_finding import found_mount


def driven(turn_rad=0.1, way_m=2.0, count=12):
    """Motions of a second each: ahead, in bends."""
    rotations = [gtsam.Rot3.Expmap(np.array([0.0, 0.0, turn_rad * np.cos(k)])) for k in range(count)]
    return [gtsam.Pose3(R, np.array([way_m, 0.0, 0.0])) for R in rotations]


def seen(moved, delta, rng=None):
    """The same by a sensor that is turned, with noise."""
    turned = gtsam.Pose3(gtsam.Rot3.Expmap(np.asarray(delta)), np.zeros(3))
    noise = (
        np.zeros((len(moved), 6)) if rng is None else rng.standard_normal((len(moved), 6)) * np.repeat([0.003, 0.03], 3)
    )
    return [turned.inverse() * one * turned * gtsam.Pose3.Expmap(off) for one, off in zip(moved, noise, strict=True)]


@pytest.mark.parametrize("delta", [(0.0, 0.0, 0.0), (0.1, -0.4, 1.0), (0.0, 0.0, 3.1), (3.0, 0.0, 0.2)])
def test_any_mount_is_found(delta):
    moved = driven()
    assert found_mount(moved, seen(moved, delta)) == pytest.approx(np.array(delta), abs=1e-6)
    noisy = found_mount(moved, seen(moved, delta, np.random.default_rng(1)))
    assert (
        np.degrees(
            np.linalg.norm(gtsam.Rot3.Logmap(gtsam.Rot3.Expmap(noisy).between(gtsam.Rot3.Expmap(np.array(delta)))))
        )
        < 3.0
    )


@pytest.mark.parametrize(
    "moved",
    [
        driven(turn_rad=0.0),  # straight ahead: how it rolls nobody sees
        driven(way_m=0.0),  # on the spot
        driven(turn_rad=1e-3, way_m=0.01),  # hardly
    ],
)
def test_motions_about_or_along_one_axis_do_not_tell(moved):
    assert found_mount(moved, seen(moved, (0.1, -0.4, 1.0))) is None


def test_one_that_stands_still_tells_nothing():
    assert found_mount(driven(), [gtsam.Pose3()] * 12) is None
