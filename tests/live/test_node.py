"""The live node without a network: what it obeys, and what it prints."""

import re
from itertools import cycle

import pytest
from bags import HUMBLE, fix, imu

from holdfast.cli.live import _show
from holdfast.config.load import parse_config
from holdfast.events import Event, EventKind
from holdfast.live.dds import Sample
from holdfast.live.line_limit import PERIOD_NS
from holdfast.live.node import LiveNode
from holdfast.live.watch import Finding
from holdfast.recording.subscriptions import subscriptions
from holdfast.state import NOTHING

CONFIG = "sensors:\n  imu: {kind: imu, topic: /imu/data}\n"
T0 = 1_700_000_000_000_000_000


class DeafNetwork:
    """Notes what the node subscribes to and publishes."""

    def __init__(self):
        self.subscribed, self.published, self.unsent = [], [], {}

    def subscribe(self, topic, *_, **__):
        self.subscribed.append(topic)

    def advertise(self, topic, *_, **__):
        return lambda data: self.published.append((topic, data))

    def publications(self):
        return []


class FullEngine:
    """Has room for three measurements of every sensor but the IMU."""

    datum, initialised, waiting_for = None, False, ""

    def __init__(self):
        self.left_out, self.taken, self.events = {}, [], []

    def room(self, sensor, _):
        return None if sensor == "imu" else 3

    def shed(self, sensor, number, _):
        self.left_out[sensor] = self.left_out.get(sensor, 0) + number

    def take_events(self):
        events, self.events = self.events, []
        return events

    def process(self, message):
        self.taken.append((message.sensor, message.stamp_ns))
        return NOTHING


def node_of(text):
    config, network, shown = parse_config(CONFIG + text), DeafNetwork(), []
    engine = FullEngine()
    node = LiveNode(config, subscriptions(config), engine, network, feeds=[], show=shown.append)
    return node, network, shown, engine


@pytest.mark.parametrize(("text", "topics"), [
    ("", ["/imu/data"]),
    ("live: {commands: false}", ["/imu/data"]),
    ("live: {commands: true}", ["/imu/data", "/holdfast/reset", "/holdfast/set_datum"]),
])  # fmt: skip
def test_commands_from_the_network_are_not_even_received_unless_configured(text, topics):
    assert node_of(text)[1].subscribed == topics


def samples(topic, message_of, count):
    name = "sensor_msgs/msg/Imu" if topic == "/imu/data" else "sensor_msgs/msg/NavSatFix"
    return [Sample(topic, name, bytes(HUMBLE.serialize_cdr(message_of(HUMBLE, T0 + k), name))) for k in range(count)]


def run_once(node, network, arrived):
    """One turn of the node's loop with what has arrived."""
    turns = iter([True, False])
    network.wait = lambda _: arrived
    node.run(lambda: next(turns))


def test_of_a_flood_the_newest_are_decoded_and_the_rest_is_counted_and_no_sample_of_the_imu_is_lost():
    node, network, _, engine = node_of(
        "  gnss: {kind: gnss, topic: /fix}\nextrinsics: [{parent: imu, child: gnss, translation_m: [0, 0, 1]}]"
    )
    run_once(node, network, samples("/imu/data", imu, 50) + samples("/fix", fix, 400))
    assert engine.taken == [("imu", T0 + k) for k in range(50)] + [("gnss", T0 + k) for k in (397, 398, 399)]
    assert engine.left_out == {"gnss": 397}
    assert (node.inputs.shed["/fix"], node.inputs.received["/fix"]) == (397, 3)


def test_lines_of_one_kind_are_few_and_hold_no_control_character():
    node, network, shown, engine = node_of("")
    engine.events = [Event(T0, EventKind.REJECTED, "gnss", f"{k} too\x1b[2J\nfast") for k in range(1000)]
    run_once(node, network, [])
    assert shown == [rf"gnss: rejected: {k} too\x1b[2J\nfast" for k in range(3)]


def test_lines_about_a_flapping_topic_and_a_flood_of_commands_are_few_too(monkeypatch):
    """A topic that fails and recovers all the time, or somebody who sends resets, filled the log."""
    node, network, shown, engine = node_of("live: {commands: true}")
    findings = cycle([{"/imu/data": Finding("silent", "is silent")}, {}])
    monkeypatch.setattr(node._watch, "review", lambda *_: next(findings))
    monkeypatch.setattr(node, "_statuses", lambda _: [])  # the engine of this test has no health
    for k in range(100):
        node._review(T0 + k)
    assert shown == ["warning: /imu/data: is silent", "/imu/data: is well again"] * 3
    shown.clear()
    engine.reset = lambda: None
    run_once(node, network, [Sample("/holdfast/reset", "std_msgs/msg/Empty", b"\0\1\0\0\0")] * 100)
    assert shown == ["warning: /holdfast/reset: the estimator begins anew"] * 3
    node._review(node._clock.now_ns() + PERIOD_NS)
    assert shown[-1] == "/holdfast/reset: reset: 97 more such lines"


def test_a_datum_far_from_the_fixes_is_told_once(monkeypatch):
    node, network, shown, _ = node_of(
        "  gnss: {kind: gnss, topic: /fix}\nextrinsics: [{parent: imu, child: gnss, translation_m: [0, 0, 1]}]\n"
        "frames: {datum: {latitude_deg: -33, longitude_deg: 151, altitude_m: 0}}"
    )
    monkeypatch.setattr(node, "_statuses", lambda _: [])  # the engine of this test has no health
    run_once(node, network, samples("/fix", fix, 2))
    for _ in range(3):
        node._review(T0)
    (line,) = (line for line in shown if "datum" in line)
    assert line.startswith("warning: frames.datum: every fix is ")


def test_every_line_on_the_terminal_begins_with_the_time(capsys):
    _show("gnss: late")
    assert re.fullmatch(r"\d\d:\d\d:\d\d\.\d{3} gnss: late\n", capsys.readouterr().err)
