"""The optimum knows what the causal run has learnt: the colour of errors, which lasts."""

from dataclasses import replace
from types import SimpleNamespace

import gtsam
import numpy as np
from motion import Drive, fixes, imu, in_order, machine, scans, seconds

from holdfast.estimator.estimator import Estimator
from holdfast.estimator.learnt_view import LearntView
from holdfast.sensors.noise import Colour
from holdfast.sensors.sensor import Position
from holdfast.smoothing.batch_smoother import BatchSmoother
from holdfast.smoothing.recorded import Recorded

END_S = 15.0
MOTION = Drive()
LASTING_M = np.array([0.01, -0.008, 0.0])
COLOUR = Colour(0.5, 0.5, 60.0)


class Shifted(Drive):
    """The same drive as fixes see it whose error lasts."""

    def pose(self, t):
        pose = super().pose(t)
        return gtsam.Pose3(pose.rotation(), pose.translation() + LASTING_M)


def block_of(batch, config, messages):
    """The only block of the optimum over some messages."""
    estimator = Estimator(config, batch)
    for message in messages:
        estimator.process(message)
    batch.stop()
    (block,) = batch.take()
    return block


def error_in_sigmas(slow_time_constant_s):
    """How many sigmas the optimum is off horizontally, where the error of the fixes lasts."""
    rng = np.random.default_rng(0)
    config = machine(gnss_={"correlation_s": 0.02, "slow_time_constant_s": slow_time_constant_s})
    sent = fixes(Shifted(), 0.0, END_S, 10.0, rng=rng, sigma=(0.007, 0.007, 0.014))
    claim = np.diag(np.square([0.014, 0.014, 0.028]))
    messages = in_order(
        imu(MOTION, 0.0, END_S, rng=rng),
        [replace(fix, covariance=claim) for fix in sent],
        scans(MOTION, 0.0, END_S, rng=rng, phase_s=0.0021),
    )
    block = block_of(BatchSmoother(config), config, messages)
    track, covariances = block.track, block.covariances.at(block.track.times_ns)
    rows = range(len(track.times_ns) // 2, len(track.times_ns), 50)
    off = [track.positions[k] - MOTION.nav(seconds(int(track.times_ns[k]))).position() for k in rows]
    sigmas = [np.sqrt(covariances[k, 3:5, 3:5].trace()) for k in rows]
    return float(np.mean([np.linalg.norm(one[:2]) for one in off]) / np.mean(sigmas))


def test_an_error_of_fixes_that_lasts_is_in_the_covariance():
    assert error_in_sigmas(60.0) < 1.5 < error_in_sigmas(0.0)


def learnt(white):
    return LearntView(
        noise=lambda _: 1.0,
        used=lambda _, __: [],
        constants=dict,
        colour=lambda _, colour, above: colour.with_white(white / above),
        force_scale=lambda: 1.0,
        sway=lambda: 0.0,
    )


def update(stamp_ns):
    state = SimpleNamespace(stamp_ns=stamp_ns, covariance=np.eye(15))
    return SimpleNamespace(state=state, smoothed=(), begins_anew=False, standing=())


def recorded_while_it_learns(measurements):
    """Return what is recorded of three measurements: before the start, and after each of two optimisations."""
    recorded = Recorded(machine())
    recorded.add(measurements[0])
    for k, white in enumerate([0.2, 0.7]):
        recorded.update(update(k + 1), learnt(white))
        recorded.add(measurements[k + 1])
    list(recorded.take(10))
    return [recorded.beside(one) for one in measurements]


def test_the_colour_that_is_known_when_a_measurement_comes_stays_beside_it():
    positions = [Position(stamp, "gnss", np.zeros(3), np.eye(3), 0.25, COLOUR) for stamp in (1, 2, 3)]
    found = recorded_while_it_learns(positions)
    assert [one.colour.white for one in found] == [COLOUR.white, 0.2, 0.7]
