"""What was learnt at the turn joint lives with the IMU path: it outlives the optimiser and a clock that goes back."""

import os
import signal
from math import radians

import pytest
from engine import bits, bring_up, play, shifted, wait_for

from holdfast.estimator.estimator import Estimator
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.sensors.constants import LearntConstant
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT, LearntJoint
from holdfast.state import EncoderState

OFF_DEG = 2.0
ZERO = LearntConstant(mean=(radians(OFF_DEG),), sigmas=(1e-3,))
LEARNT = LearntSnapshot(joint=LearntJoint(zero=ZERO))
STANDS_S = 3.0  # quick stands until then


@pytest.fixture(scope="module")
def config(drive):
    """The file has the zero of the encoder 2 deg off."""
    name, joint = drive.config.joint
    wrong = joint.model_copy(update={"zero_offset_deg": joint.zero_offset_deg - OFF_DEG})
    return drive.config.model_copy(update={"sensors": drive.config.sensors | {name: wrong}})


def last_base(outputs):
    return [output.base for output in outputs if output.base is not None][-1]


def first_base(outputs):
    return next(output.base for output in outputs if output.base is not None)


def test_the_zero_is_used_from_the_first_estimate(drive, config):
    without, known = (
        first_base(play(Estimator(config, learnt=one), drive.until(STANDS_S))) for one in (NOTHING_LEARNT, LEARNT)
    )
    assert known.joint_angle_rad - without.joint_angle_rad == pytest.approx(radians(OFF_DEG), abs=radians(0.1))
    assert known.encoder is EncoderState.WRONG_ZERO and without.encoder is EncoderState.OK


def test_both_engines_give_the_same_bits_and_learn_the_same(drive, config):
    inline = Estimator(config, learnt=LEARNT)
    with RealtimeEstimator(config, in_step=True, learnt=LEARNT) as engine:
        for number, message in enumerate(drive.until(5.0)):
            assert bits(engine.process(message)) == bits(inline.process(message)), f"message {number}"
    assert engine.learnt().joint == inline.learnt().joint != NOTHING_OF_JOINT


def test_a_killed_optimiser_does_not_touch_it_and_a_reset_forgets_it(drive, config):
    with RealtimeEstimator(config, learnt=LEARNT) as engine:
        bring_up(engine, drive.until(STANDS_S))
        before, first = engine.learnt().joint, engine.optimiser_pid
        assert before.zero is not None
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: engine.event_counts["optimiser_fault"] == 1)
        outputs = play(engine, drive.between(STANDS_S, STANDS_S + 0.3), rate=0.3)
        assert last_base(outputs).encoder is EncoderState.WRONG_ZERO
        wait_for(lambda: engine.optimiser_pid not in {None, first})
        engine.flush()
        assert engine.learnt().joint.zero.mean[0] == pytest.approx(before.zero.mean[0], abs=3.0 * ZERO.sigmas[0])
        engine.reset()
        engine.flush()
        assert engine.learnt() == NOTHING_LEARNT


def test_a_clock_that_goes_back_does_not_make_it_forget_nor_does_a_datum_but_a_reset_does(drive, config):
    estimator = Estimator(config, learnt=LEARNT)
    play(estimator, drive.until(STANDS_S))
    before = estimator.learnt().joint
    again = first_base(play(estimator, shifted(drive.until(STANDS_S), -3_600_000_000_000)))
    assert again.encoder is EncoderState.WRONG_ZERO
    assert estimator.learnt().joint == before
    estimator.set_datum(estimator.datum)
    assert estimator.learnt().joint == before
    estimator.reset()
    assert estimator.learnt().joint == NOTHING_OF_JOINT
    after = first_base(play(estimator, shifted(drive.until(STANDS_S), 3_600_000_000_000)))
    assert after.encoder is EncoderState.OK


def test_what_is_learnt_in_a_run_is_known_after_a_clock_that_went_back(drive, config):
    estimator = Estimator(config)
    play(estimator, drive.messages)
    learnt = estimator.learnt().joint
    assert learnt.zero.mean[0] == pytest.approx(radians(OFF_DEG), abs=radians(0.5))
    again = first_base(play(estimator, shifted(drive.until(STANDS_S), -3_600_000_000_000)))
    assert again.encoder is EncoderState.WRONG_ZERO
