"""Two antennas whose positions come by each other's name are found where the estimate expects both, and taken so."""

from itertools import pairwise

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.integrity.exchanges import ENOUGH, Exchange, Exchanges, ExchangeTest
from holdfast.sensors.sensor import Position

AT = {"left": np.array([0.0, 1.0, 2.0]), "right": np.array([0.0, -1.0, 2.0]), "mast": np.array([0.0, 0.0, 4.0])}
PERIOD_NS = 100_000_000


def position(sensor, p_W_P, k=0):
    return Position(k * PERIOD_NS, sensor, p_W_P, np.eye(3) * 1e-4, 0.0)


def told(sequence):
    """What a sequence of (who sends, whose place it is; None: nobody's) shows."""
    test, results = ExchangeTest(), []
    for k, (sensor, place) in enumerate(sequence):
        others = () if place in (None, sensor) else (place,)
        found = test.note(position(sensor, np.zeros(3), k), others, is_expected=place == sensor)
        results += [(one.pair, one.since_ns // PERIOD_NS, k) for one in found]
    return results


BOTH = [("left", "right"), ("right", "left")]


def test_so_many_positions_of_either_must_be_where_the_other_is_expected():
    assert told(BOTH * ENOUGH) == [(("left", "right"), 0, 2 * ENOUGH - 1)]
    assert not told(BOTH * (ENOUGH - 1))


def test_one_that_walks_by_the_place_of_the_other_is_not_exchanged():
    assert not told([("left", "right"), ("right", None)] * 10)


def test_one_that_is_where_it_is_expected_begins_the_count_anew():
    assert not told((BOTH * (ENOUGH - 1) + [("right", "right")]) * 3)


def test_spikes_say_nothing():
    assert told([*BOTH, ("left", None)] * ENOUGH) == [(("left", "right"), 0, 3 * ENOUGH - 2)]
    assert not told([("left", None)] * 50)


def test_what_was_long_ago_does_not_count():
    assert not told([("left", "right")] * ENOUGH + [("left", None)] * 60 + [("right", "left")] * ENOUGH)


def test_of_three_antennas_the_two_that_are_exchanged_are_found():
    sequence = [("left", "right"), ("right", "left"), ("mast", "mast")] * 3
    assert [pair for pair, *_ in told(sequence)] == [("left", "right")]


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
