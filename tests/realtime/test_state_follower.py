"""Optimised states out of the shared memory: only those of the present epoch; without new ones the path goes on."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from holdfast.config.model import Config
from holdfast.estimator.health import HealthMonitor
from holdfast.estimator.imu_path import ImuPath
from holdfast.event_log import EventLog
from holdfast.geometry.earth import Geodetic
from holdfast.messages import ImuSample
from holdfast.realtime.follower import StateFollower
from holdfast.realtime.layout import Board
from holdfast.realtime.records import Published, Records
from holdfast.sensors.imu import ImuBuffer
from holdfast.state import OptimisedState

CONFIG = Config.model_validate({"sensors": {"imu": {"kind": "imu", "topic": "/imu"}}})
SECOND_NS = 1_000_000_000
DATUM = Geodetic(47.0, 8.0, 400.0)
G = 9.81


def state_at(t_s, east_m=0.0):
    nav = gtsam.NavState(gtsam.Rot3(), np.array([east_m, 0.0, 0.0]), np.zeros(3))
    sigmas = np.repeat([1e-3, 1e-2, 1e-2, 1e-3, 1e-5], 3)
    return OptimisedState(round(t_s * SECOND_NS), nav, gtsam.imuBias.ConstantBias(), np.diag(sigmas**2), np.zeros(3))


class Standing:
    """A machine that stands, its IMU path and what an optimiser publishes beside it."""

    def __init__(self):
        self.records = Records(CONFIG)
        self.board = Board(self.records)
        self.buffer = ImuBuffer(CONFIG.imu)
        self.path = ImuPath(CONFIG, self.buffer, EventLog("imu"))
        self.follower = StateFollower(CONFIG, self.board, self.records, self.path, self.buffer)
        self.t = 0.0

    def go(self, until_s):
        """Return the last estimate."""
        estimate = None
        while self.t < until_s - 1e-9:
            self.t += 0.01
            stamp = round(self.t * SECOND_NS)
            jitter = 1e-6 * np.sin([self.t * 977.0, self.t * 1231.0, self.t * 1511.0])
            sample = ImuSample(stamp, stamp, "imu", jitter, np.array([0.0, 0.0, G]) + jitter)
            estimate = self.path.process(sample).estimate or estimate
            if stamp > self.follower.rescue_ns:
                self.follower.rescue()
        return estimate

    def publish(self, state, **changes):
        fields = {
            "epoch": 0,
            "life": 1,
            "updates": 1,
            "recoveries": 0,
            "is_lost": False,
            "lost": (),
            "datum": None,
            "state": state,
            "gravity": G,
        }
        record = Published(health=HealthMonitor(CONFIG).snapshot(), **(fields | changes))
        self.board.published.write(self.records.pack_published(record))


@pytest.fixture
def standing():
    found = Standing()
    yield found
    found.board.close()


def test_there_is_nothing_to_take_in_before_something_is_published(standing):
    assert not standing.follower.has_new and standing.follower.take() is None
    standing.publish(None, datum=DATUM)
    assert standing.follower.has_new
    assert standing.follower.take() is None  # W is known, a state is not
    assert standing.follower.world.datum == DATUM and standing.follower.newest is None
    assert not standing.follower.has_new


def test_the_first_state_starts_the_path_and_the_next_ones_correct_it(standing):
    standing.go(1.0)
    standing.publish(state_at(0.9, 5.0))
    assert standing.follower.take().stamp_ns == 900_000_000
    assert standing.go(1.1).nav.position()[0] == pytest.approx(5.0, abs=1e-3)
    standing.publish(state_at(1.05, 5.2), updates=2)
    standing.follower.take()
    estimate = standing.go(1.2)
    assert estimate.nav.position()[0] == pytest.approx(5.2, abs=1e-3)
    # O takes the correction, it does not step
    assert (estimate.T_W_O.inverse() * estimate.nav.pose()).translation()[0] == pytest.approx(5.0, abs=1e-3)


def test_a_new_life_starts_the_path_anew_and_o_with_it(standing):
    standing.go(1.0)
    standing.publish(state_at(0.9, 5.0))
    standing.follower.take()
    standing.publish(state_at(0.95, 7.0), life=2)
    standing.follower.take()
    estimate = standing.go(1.1)
    assert (estimate.T_W_O.inverse() * estimate.nav.pose()).translation()[0] == pytest.approx(7.0, abs=1e-3)


def test_a_state_of_before_a_reset_is_not_taken_in(standing):
    standing.go(1.0)
    standing.publish(state_at(0.9))
    standing.follower.begin_anew()
    assert standing.follower.take() is None and standing.path.is_running is False
    standing.publish(state_at(0.95), epoch=1)
    assert standing.follower.take() is not None


def test_without_news_for_five_seconds_the_propagated_state_takes_the_place_of_the_optimised_one(standing):
    standing.go(1.0)
    standing.publish(state_at(0.9, 5.0))
    standing.follower.take()
    standing.go(5.8)
    assert standing.board.rescue.read() is None
    standing.go(6.0)
    rescued = standing.follower.newest.state
    assert rescued.stamp_ns >= 5_900_000_000
    assert rescued.nav.position()[0] == pytest.approx(5.0, abs=0.01)
    # a successor finds it, and an optimiser that was stopped meanwhile does not lead back
    _, packed = standing.board.rescue.read()
    assert standing.records.unpack_published(packed).state.stamp_ns == rescued.stamp_ns
    standing.publish(state_at(1.1, 9.0), updates=2)
    assert standing.follower.take() is None
    assert standing.go(6.1).nav.position()[0] == pytest.approx(5.0, abs=0.01)
    standing.publish(replace(state_at(6.05, 5.1)), updates=3)
    assert standing.follower.take() is not None
    standing.go(10.0)  # the patience begins anew
    assert standing.board.rescue.version == 1
