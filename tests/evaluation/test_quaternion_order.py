"""Files with their quaternions in the order w x y z are told from those that only have other frames."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast.evaluation import quaternions
from holdfast.evaluation.association import associate
from holdfast.evaluation.quaternion_order import reordered
from holdfast.state import Trajectory

S = 1_000_000_000


def drive(roll_rad=0.0, yaw_rad=4.0):
    """A turn about the vertical, on ground that rolls."""
    time = np.linspace(0.0, 40.0, 400)
    yaw, roll = yaw_rad * time / 40.0, roll_rad * np.sin(time)
    z, x = np.zeros((2, 400, 4))
    z[:, 2:], x[:, [0, 3]] = (np.stack([f(angle / 2) for f in (np.sin, np.cos)], axis=1) for angle in (yaw, roll))
    positions = np.stack([np.sin(yaw), 1.0 - np.cos(yaw), 0.1 * np.sin(time)], axis=1) * 10.0
    return Trajectory((time * S).astype(np.int64), positions, quaternions.multiply(z, x))


def as_wxyz(track):
    """The track of a file with the other order, as it is read."""
    return replace(track, quaternions=np.roll(track.quaternions, 1, axis=1))


def noisy(track, sigma_rad=0.01):
    errors = np.random.default_rng(0).normal(0.0, sigma_rad / 2, (400, 3))
    small = np.hstack([errors, np.sqrt(1.0 - np.square(errors).sum(axis=1, keepdims=True))])
    return replace(track, quaternions=quaternions.multiply(track.quaternions, small))


@pytest.mark.parametrize(("estimate", "reference", "found"), [
    (as_wxyz(noisy(drive(0.3))), drive(0.3), ("estimate",)),
    (noisy(drive(0.3)), as_wxyz(drive(0.3)), ("reference",)),
    (as_wxyz(noisy(drive())), drive(), ("estimate", "reference")),
])  # fmt: skip
def test_the_other_order_is_told(estimate, reference, found):
    assert reordered(associate(estimate, reference)) == found


def turned(track, *, in_body, in_world):
    return replace(track, quaternions=quaternions.multiply(
        np.array(in_world), quaternions.multiply(track.quaternions, np.array(in_body)))
    )  # fmt: skip


@pytest.mark.parametrize("in_body", [(0.5, -0.5, 0.5, 0.5), (1.0, 0.0, 0.0, 0.0), (0.0, 0.6, 0.0, 0.8)])
@pytest.mark.parametrize("in_world", [(0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.6, 0.8)])
@pytest.mark.parametrize("roll_rad", [0.0, 0.3])
def test_other_frames_of_body_and_world_are_no_other_order(in_body, in_world, roll_rad):
    estimate = turned(noisy(drive(roll_rad)), in_body=in_body, in_world=in_world)
    assert reordered(associate(estimate, drive(roll_rad))) == ()


def test_who_hardly_turns_tells_nothing():
    assert reordered(associate(as_wxyz(drive(0.0, 0.1)), drive(0.0, 0.1))) == ()


def test_an_estimate_that_turns_the_other_way_is_only_wrong():
    assert reordered(associate(drive(0.0, -4.0), drive(0.0, 4.0))) == ()
