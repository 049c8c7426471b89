"""Ctrl-C interrupts between two pieces of work."""

import signal

import pytest

from holdfast.replay.interrupts import Uninterrupted


def test_work_that_has_begun_is_finished_before_ctrl_c_interrupts():
    uninterrupted, done = Uninterrupted(), []
    uninterrupted.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            for k in range(3):
                with uninterrupted:
                    if k == 1:
                        signal.raise_signal(signal.SIGINT)
                    done.append(k)
        assert done == [0, 1]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)  # no work: at once
    finally:
        uninterrupted.stop()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_program_that_ignores_ctrl_c_goes_on_ignoring_it():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        uninterrupted = Uninterrupted()
        uninterrupted.start()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        uninterrupted.stop()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_handler_of_ones_own_is_called_when_the_work_is_done():
    seen = []
    before = signal.signal(signal.SIGINT, lambda *_: seen.append("interrupted"))
    try:
        uninterrupted = Uninterrupted()
        uninterrupted.start()
        with uninterrupted:
            signal.raise_signal(signal.SIGINT)
            seen.append("work")
        uninterrupted.stop()
    finally:
        signal.signal(signal.SIGINT, before)
    assert seen == ["work", "interrupted"]
