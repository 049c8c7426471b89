"""Guesses which topic of a recording is which sensor: by type, words in the name, number of messages."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol


class Topic(Protocol):
    """What a recording tells of a topic."""

    @property
    def topic(self) -> str:
        """Return its name."""

    @property
    def type(self) -> str:
        """Return its message type as in ROS 2."""

    @property
    def count(self) -> int | None:
        """Return the number of messages, None if unknown."""


@dataclass(frozen=True)
class Rule:
    """How a sensor's topic is told: words in its name that speak for it and against it.

    Attributes:
        named: without one of the words in `prefer` a topic is not taken.
        last_resort: a topic with a word of `avoid` is taken where there is no other.
    """

    kind: str
    prefer: tuple[str, ...] = ()
    avoid: tuple[str, ...] = ()
    named: bool = False
    last_resort: bool = False


LEFT = ("left", "main", "master", "primary", "front", "l")
RIGHT = ("right", "aux", "slave", "secondary", "rover", "rear", "r")
DERIVED = ("filtered", "fused", "ekf", "ukf", "truth", "reference", "holdfast")
CHASSIS = ("base", "chassis", "undercarriage", "track")

# in the order in which they choose; a topic is given once
RULES = {
    "heading": Rule("heading", ("heading", "yaw", "compass", "dual", "baseline", "relpos"), DERIVED, named=True),
    "imu": Rule(
        "imu",
        ("cabin", "data"),
        (*CHASSIS, *DERIVED, "mag", "camera", "ouster", "livox", "velodyne", "heading"),
        last_resort=True,
    ),
    "gnss": Rule("gnss", LEFT, (*RIGHT, *DERIVED), last_resort=True),
    "gnss_right": Rule("gnss", RIGHT, DERIVED, named=True),
    "lidar": Rule(
        "lidar",
        ("lidar", "laser", "icp", "slam", "loam", "lio", "scan", "odom"),
        (*CHASSIS, *DERIVED, "wheel", "gnss", "gps", "visual", "vio", "camera", "goal"),
    ),
    "joint": Rule("joint", ("turn", "swing", "slew", "cabin", "joint_states")),
}


@dataclass(frozen=True)
class Guess:
    """The topic that is taken for a sensor (None: no topic), why, and which others of its type no sensor took."""

    topic: str | None
    reason: str
    others: tuple[Topic, ...] = ()


def assign(topics: Iterable[Topic], types: Mapping[str, Collection[str]]) -> dict[str, Guess]:
    """Return a guess per sensor.

    Args:
        topics: what the recording holds.
        types: kind of measurement -> the message types that it can be decoded from.
    """
    remaining = {topic.topic: topic for topic in topics}
    guesses = {}
    imus = [topic.topic for topic in remaining.values() if topic.type in types.get("imu", ())]
    only_imu = imus[0] if len(imus) == 1 else None  # whatever its name says: without an IMU nothing works
    for sensor, rule in RULES.items():
        allowed = types.get(rule.kind, ())
        candidates = [topic for topic in remaining.values() if topic.type in allowed]
        if sensor != "imu":
            candidates = [topic for topic in candidates if topic.topic != only_imu]
        guess = _choose(rule, candidates, allowed)
        guesses[sensor] = guess
        if guess.topic is not None:
            del remaining[guess.topic]
    taken = {guess.topic for guess in guesses.values()}
    return {
        sensor: Guess(guess.topic, guess.reason, tuple(other for other in guess.others if other.topic not in taken))
        for sensor, guess in guesses.items()
    }


def described(topic: Topic) -> str:
    """Return a topic with its type and number of messages, on one line."""
    count = "" if topic.count is None else f", {topic.count} messages"
    return f"{topic.topic} ({topic.type}{count})"


def _choose(rule: Rule, candidates: list[Topic], types: Collection[str]) -> Guess:
    """Return the best of the candidates, unless their names or their emptiness speak against all."""
    if not candidates:
        return Guess(None, f"no further topic of type {' or '.join(types) or rule.kind}")
    ranked = sorted(candidates, key=lambda topic: (*_score(rule, topic), topic.topic))
    best, others = ranked[0], tuple(ranked[1:])
    against = _words(best.topic, rule.avoid)
    if best.count == 0:
        return Guess(None, "topics without any message", tuple(ranked))
    if (against and not rule.last_resort) or (rule.named and not _words(best.topic, rule.prefer)):
        return Guess(None, "no name among those of its type speaks for one", tuple(ranked))
    return Guess(best.topic, f"{described(best)}, {_reason(rule, best, len(others))}", others)


def _score(rule: Rule, topic: Topic) -> tuple[bool, bool, bool, int]:
    """Return a key that sorts the best first: not empty, nothing against it, something for it, many messages."""
    words_for, words_against = _words(topic.topic, rule.prefer), _words(topic.topic, rule.avoid)
    return topic.count == 0, bool(words_against), not words_for, -(topic.count or 0)


def _reason(rule: Rule, best: Topic, others: int) -> str:
    words_for, words_against = _words(best.topic, rule.prefer), _words(best.topic, rule.avoid)
    if words_against:
        return f"although {words_against[0]!r} in its name speaks AGAINST it: there is no better one"
    if not others:
        return "the only one"
    if words_for:
        return f"for {words_for[0]!r} in its name"
    return "for its number of messages"


def _words(name: str, words: Iterable[str]) -> list[str]:
    """Return which words are in a name; very short ones must stand alone (`gnss_l`)."""
    lower = name.lower()
    parts = re.split(r"[^a-z]+", lower)
    return [word for word in words if (word in lower if len(word) > 2 else word in parts)]
