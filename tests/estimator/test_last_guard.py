"""What is not finite never gets out: it is a fault of the optimiser, and the estimator begins anew."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, deviation, estimates, fixes, imu, in_order, machine, ns, run, scans

from holdfast.errors import ConfigError
from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind
from holdfast.graph.window import Window
from holdfast.sensors.registry import sensors_of
from holdfast.state import is_finite

DRIVE = Drive()
NAN = np.full(3, np.nan)


def recorded(end_s=12.0):
    rng = np.random.default_rng(1)
    return in_order(
        imu(DRIVE, 0.0, end_s, 100.0, rng),
        fixes(DRIVE, 0.0, end_s, 10.0, rng, phase_s=0.0137),
        scans(DRIVE, 0.0, end_s, 5.0, rng, phase_s=0.0071),
    )


def broken(nav, what):
    """A state that arithmetic might have ruined."""
    R, p, v = nav.attitude(), nav.position(), nav.velocity()
    return {
        "attitude": gtsam.NavState(gtsam.Rot3.Expmap(NAN), p, v),
        "position": gtsam.NavState(R, NAN, v),
        "velocity": gtsam.NavState(R, p, np.full(3, np.inf)),
    }[what]


def faults(estimator):
    return [event.reason for event in estimator.events if event.kind is EventKind.OPTIMISER_FAULT]


@pytest.mark.parametrize("what", ["attitude", "position", "velocity"])
def test_a_state_that_is_not_finite_is_seen_whatever_of_it_is(what):
    nav = DRIVE.nav(0.0)  # at rest, where a broken attitude turns a velocity of zero
    assert is_finite(nav)
    assert not is_finite(broken(nav, what))


@pytest.mark.parametrize("what", ["attitude", "position", "velocity"])
def test_an_estimate_that_would_not_be_finite_is_not_given_and_all_begins_anew(what):
    estimator = Estimator(machine())
    messages, given = recorded(), []
    for message in messages:
        if message.sensor == "imu" and message.stamp_ns == ns(6.0):
            state = estimator._optimiser.tracking.graph.published.newest
            estimator._path.anchor(replace(state, nav=broken(state.nav, what)), is_recovery=False)
        given.append(estimator.process(message))
    assert faults(estimator) == ["the estimate is not finite: starting over"]
    assert all(np.isfinite(e.nav.matrix()).all() and np.isfinite(e.T_W_O.matrix()).all() for e in estimates(given))
    later = [e for e in estimates(given) if e.stamp_ns > ns(10.0)]
    assert len(later) == 200
    assert max(deviation(DRIVE, e)[0] for e in later) < 0.1


def test_an_optimised_state_whose_bias_is_not_finite_is_a_fault_of_the_optimiser(monkeypatch):
    calls, bias = [0], Window.bias

    def ruined(window, key):
        calls[0] += 1
        return gtsam.imuBias.ConstantBias(NAN, NAN) if calls[0] == 50 else bias(window, key)

    monkeypatch.setattr(Window, "bias", ruined)
    estimator, outputs = run(machine(), recorded(9.0))
    assert faults(estimator) == ["the optimised state is not finite"]
    assert all(o.optimised is None or o.optimised.is_finite() for o in outputs)
    assert estimates(outputs)[-1].stamp_ns == ns(9.0)


def test_a_heading_between_antennas_at_one_place_is_refused_by_its_name():
    config = machine(right=True, heading=True)
    at_one_place = [
        one.model_copy(update={"translation_m": tuple(ARM)}) if one.child == "right" else one
        for one in config.extrinsics
    ]
    with pytest.raises(ConfigError, match=r"sensors\.heading: the two antennas of its baseline sit at one place"):
        sensors_of(config.model_copy(update={"extrinsics": at_one_place}))
