"""Guesses which topics of a recording are which sensors: by type, words in the name, number of messages."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

PLAIN = ("vel", "velocity")  # names that tell nothing of the sensor


class Topic(Protocol):
    """What a recording reports of a topic."""

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
    """How the topics of a sensor are found: words in their names that speak for it and against it.

    Attributes:
        sensor: its name in the configuration; further ones get a number.
        prefer: words that speak for a topic.
        avoid: words for which a topic is not taken.
        named: without one of the words in `prefer` a topic is not taken. Such rules choose first.
        last_resort: a topic with a word of `avoid` is taken where there is no other; the only one of its type is.
        every: all topics that fit become a sensor each.
        spare: they are not used, but a user may want them; such rules choose last.
        on_chassis: the sensor sits below the turn joint, where there is one.
        types: the only message types that are taken; if empty, all of the kind.
        beside: a topic called `PLAIN` in the namespace of a topic of this type needs no word of `prefer`.
        given: what else stands in the section of the sensor.
    """

    sensor: str
    prefer: tuple[str, ...] = ()
    avoid: tuple[str, ...] = ()
    named: bool = False
    last_resort: bool = False
    every: bool = False
    spare: bool = False
    on_chassis: bool = False
    types: tuple[str, ...] = ()
    beside: str = ""
    given: Mapping[str, Any] = field(default_factory=dict)


class TopicKind(Protocol):
    """A kind of measurement, as it is found in a recording."""

    @property
    def name(self) -> str:
        """Return the `kind` of its sensors in the configuration."""

    @property
    def types(self) -> Collection[str]:
        """Return the message types that it can be decoded from."""

    @property
    def rules(self) -> tuple[Rule, ...]:
        """Return how its topics are found; those of one kind choose in this order."""


@dataclass(frozen=True)
class Measured:
    """What the messages of a topic came to, for its section in a configuration.

    Attributes:
        notes: lines above the section.
        remarks: what stands beside a key.
        values: of keys whose default the messages contradict.
        warnings: what is wrong with the messages, one line each.
    """

    notes: tuple[str, ...] = ()
    remarks: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, float | str | tuple[float, ...]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def joined(self, other: "Measured") -> "Measured":
        """Return both in one."""
        return Measured(
            (*self.notes, *other.notes),
            {**self.remarks, **other.remarks},
            {**self.values, **other.values},
            (*self.warnings, *other.warnings),
        )


@dataclass(frozen=True)
class Guess:
    """A topic that is taken for a sensor, and why."""

    sensor: str
    kind: str
    rule: Rule
    topic: Topic
    reason: str


@dataclass(frozen=True)
class Assignment:
    """What was found in a recording.

    Attributes:
        guesses: one per sensor, in the order of the kinds and of their rules.
        unused: topics that could be a sensor and that no rule took, with the kinds that they could be.
    """

    guesses: tuple[Guess, ...]
    unused: tuple[tuple[Topic, tuple[str, ...]], ...]


def assign(topics: Iterable[Topic], kinds: Iterable[TopicKind]) -> Assignment:
    """Return which topics are which sensors; a topic is given to one sensor only."""
    remaining = {topic.topic: topic for topic in topics}
    namespaces = {(topic.type, namespace(topic)) for topic in remaining.values()}
    rules = [(kind, rule) for kind in kinds for rule in kind.rules]
    reserved = {topic: rule for kind, rule in rules for topic in _reserved(kind, rule, remaining.values())}
    guesses: list[Guess] = []
    for kind, rule in sorted(rules, key=lambda pair: (pair[1].spare, not pair[1].named)):
        types = rule.types or kind.types
        candidates = [t for t in remaining.values() if t.type in types and reserved.get(t.topic, rule) is rule]
        plain = {t.topic for t in candidates if t.topic.rpartition("/")[2] in PLAIN}
        beside = {name for name in plain if (rule.beside, namespace(remaining[name])) in namespaces}
        for topic, reason in _choose(rule, candidates, beside):
            del remaining[topic.topic]
            sensor = _free_name(rule.sensor, {guess.sensor for guess in guesses})
            guesses.append(Guess(sensor, kind.name, rule, topic, reason))
    order = [rule for _, rule in rules]
    unused = [(topic, tuple(kind.name for kind in kinds if topic.type in kind.types)) for topic in remaining.values()]
    return Assignment(
        tuple(sorted(guesses, key=lambda guess: order.index(guess.rule))),
        tuple((topic, names) for topic, names in unused if names),
    )


def namespace(topic: Topic) -> str:
    """Return the name of a topic without its last part."""
    return topic.topic.rpartition("/")[0]


def described(topic: Topic) -> str:
    """Return a topic with its type and number of messages, on one line."""
    count = "" if topic.count is None else f", {topic.count} messages"
    return f"{topic.topic} ({topic.type}{count})"


def _reserved(kind: TopicKind, rule: Rule, topics: Iterable[Topic]) -> list[str]:
    """Return the only topic of a kind that cannot do without: its rule of last resort takes it, whatever its name."""
    names = [topic.topic for topic in topics if topic.type in kind.types]
    return names if rule.last_resort and len(names) == 1 else []


def _choose(rule: Rule, candidates: list[Topic], beside: Collection[str]) -> Iterator[tuple[Topic, str]]:
    """Yield the best of the candidates with the reason, or where the rule takes every one, all that fit."""
    ranked = sorted(candidates, key=lambda topic: (*_score(rule, topic), topic.topic))
    fitting = [topic for topic in ranked if _fits(rule, topic, topic.topic in beside)]
    for topic in fitting if rule.every else fitting[:1]:
        yield topic, f"{described(topic)}, {_reason(rule, topic, len(ranked) - 1)}"


def _fits(rule: Rule, topic: Topic, is_beside: bool) -> bool:
    """Return whether neither a topic's name nor its emptiness speaks against it."""
    against = _words(topic.topic, rule.avoid) and not rule.last_resort
    unnamed = rule.named and not is_beside and not _words(topic.topic, rule.prefer)
    return topic.count != 0 and not against and not unnamed


def _score(rule: Rule, topic: Topic) -> tuple[bool, bool, bool, int]:
    """Return a key that sorts the best first: not empty, nothing against it, something for it, many messages."""
    words_for, words_against = _words(topic.topic, rule.prefer), _words(topic.topic, rule.avoid)
    return topic.count == 0, bool(words_against), not words_for, -(topic.count or 0)


def _reason(rule: Rule, best: Topic, others: int) -> str:
    words_for, words_against = _words(best.topic, rule.prefer), _words(best.topic, rule.avoid)
    if words_against:
        return f"although {words_against[0]!r} in its name speaks AGAINST it: there is no better one"
    if words_for and (others or rule.named):
        return f"for {words_for[0]!r} in its name"
    if rule.named:
        return f"for a {rule.beside} beside it"
    if not others:
        return "the only one"
    return "one of several" if rule.every else "for its number of messages"


def _words(name: str, words: Iterable[str]) -> list[str]:
    """Return which words are in a name; very short ones must stand alone (`gnss_l`)."""
    lower = name.lower()
    parts = re.split(r"[^a-z]+", lower)
    return [word for word in words if (word in lower if len(word) > 2 else word in parts)]


def _free_name(name: str, taken: Collection[str]) -> str:
    """Return the name, or the name with the first number from 2 on that is free."""
    number = 2
    free = name
    while free in taken:
        free = f"{name}_{number}"
        number += 1
    return free
