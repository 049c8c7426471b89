"""Two antennas whose positions come by each other's name are found where the estimate expects both, and taken so."""

from itertools import pairwise

import numpy as np
import pytest

from holdfast.event_log import EventLog
from holdfast.integrity.exchanges import IN_A_ROW, Exchange, Exchanges, ExchangeTest
from holdfast.integrity.receiver import Prediction
from holdfast.sensors.sensor import Position
from holdfast.state import EventKind, Outcome

LIMIT = 16.0
JUMP = np.array([0.3, 0.0, 0.0])
AT = {"left": np.array([0.0, 1.0, 2.0]), "right": np.array([0.0, -1.0, 2.0]), "mast": np.array([0.0, 0.0, 4.0])}
PERIOD_NS = 100_000_000


def position(sensor, p_W_P, k=0):
    return Position(k * PERIOD_NS, sensor, p_W_P, np.eye(3) * 1e-4, 0.0)


def found(test, k, measured, sigma_m=0.02):
    """What positions at a time (sensor -> (3,) [m]) show, of a machine whose antennas are expected at AT."""
    results = []
    for name, at in measured.items():
        prediction = Prediction(at - AT[name], np.eye(3) * sigma_m**2, np.eye(3) * 1e-4, np.zeros((3, 3)))
        results += test.note(position(name, at, k), prediction, LIMIT)
    return results


SWAPPED = {"left": AT["right"], "right": AT["left"]}


def test_so_many_times_in_a_row_both_must_be_where_the_other_is_expected():
    test = ExchangeTest()
    told = [found(test, k, SWAPPED) for k in range(IN_A_ROW)]
    assert told[:-1] == [[]] * (IN_A_ROW - 1)
    assert [(one.pair, one.since_ns) for one in told[-1]] == [(("left", "right"), 0)]


def test_a_pair_that_is_where_it_is_expected_breaks_the_row():
    test = ExchangeTest()
    for k in range(4 * IN_A_ROW):
        assert not found(test, k, AT if k % IN_A_ROW == IN_A_ROW - 1 else SWAPPED)


@pytest.mark.parametrize(
    "measured",
    [
        AT,
        {"left": AT["right"], "right": AT["right"]},  # one receiver repeats the other
        {name: at + JUMP for name, at in AT.items()},  # both have jumped
        {"left": AT["right"] + JUMP, "right": AT["left"] + JUMP},
        {"left": AT["right"], "mast": AT["left"]},
    ],
)
def test_what_is_not_where_the_other_is_expected_is_no_exchange(measured):
    test = ExchangeTest()
    assert not any(found(test, k, measured) for k in range(2 * IN_A_ROW))


def test_an_estimate_that_expects_either_says_nothing():
    test = ExchangeTest()
    assert not any(found(test, k, SWAPPED, sigma_m=2.0) for k in range(2 * IN_A_ROW))


def test_positions_of_different_times_are_no_pair():
    test = ExchangeTest()
    for k in range(4 * IN_A_ROW):
        assert not found(test, k, {name: at for i, (name, at) in enumerate(SWAPPED.items()) if i == k % 2})


def test_of_three_antennas_the_two_that_are_exchanged_are_found():
    test = ExchangeTest()
    results = [one for k in range(IN_A_ROW) for one in found(test, k, SWAPPED | {"mast": AT["mast"]})]
    assert [one.pair for one in results] == [("left", "right")]


def names(exchanges):
    return {name: exchanges.named(position(name, at)).sensor for name, at in AT.items()}


def test_positions_are_taken_by_the_name_of_the_antenna_that_they_are_of():
    exchanges, log = Exchanges(), EventLog("imu")
    before = names(exchanges)
    exchanges.add(Exchange(("left", "right")), 0, log)
    assert names(exchanges) == {"left": "right", "right": "left", "mast": "mast"}
    exchanges.add(Exchange(("left", "right")), 0, log)
    assert names(exchanges) == before == {name: name for name in AT}
    reasons = [event.reason for event in log.take_events() if event.kind is EventKind.LEVER_ARM]
    assert "are exchanged" in reasons[0]
    assert reasons[1] == "each is where the file says again"


def test_exchanges_follow_on_each_other():
    """Whoever is called mast is at the place of right, after it was exchanged with left and this with right."""
    exchanges, log = Exchanges(), EventLog("imu")
    expected = {name: name for name in AT}
    for one, other in pairwise(["mast", "left", "right"]):
        exchanges.add(Exchange((one, other)), 0, log)
        turned = {one: other, other: one}
        expected = {said: turned.get(really, really) for said, really in expected.items()}
        assert names(exchanges) == expected


def test_what_is_no_position_keeps_its_name():
    exchanges = Exchanges()
    exchanges.add(Exchange(("left", "right")), 0, EventLog("imu"))
    assert exchanges.named(Outcome.LOW_STATUS) is Outcome.LOW_STATUS
