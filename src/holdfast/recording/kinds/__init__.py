"""The kinds of measurements that recordings and live topics can hold: one file each, which ends with its row.

A new kind is one file here, or `register(Kind(...))` in a program: from then on the readers, `holdfast info`,
`holdfast live` and `holdfast config init` know it.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pkgutil import iter_modules
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from holdfast.config.assignment import Measured, Rule
from holdfast.errors import RecordingError
from holdfast.messages import Array, Message
from holdfast.recording.columns import Columns
from holdfast.recording.decode import Decoder, DecoderFactory
from holdfast.recording.source import Subscription

# words in the names of topics that several kinds look for or avoid
CHASSIS = ("base", "chassis", "undercarriage", "track")
COMMAND = ("cmd", "command", "goal", "target")
DERIVED = ("filtered", "fused", "ekf", "ukf", "truth", "reference", "holdfast")
INERTIAL = ("/ins", "twist_ins")  # what an inertial navigation system made of GNSS and an IMU
SATELLITE = ("gnss", "gps")
WHEEL = ("wheel", "track")


class Findings(Protocol):
    """What the values of one topic come to; a dataclass, so that it can be written as JSON."""

    def summary(self) -> str:
        """Return it in one line."""

    def problems(self, count: int) -> Iterator[str]:
        """Yield what is wrong, one sentence per problem, of a topic with so many messages."""

    def measured(self) -> Measured:
        """Return what `holdfast config init` writes of them."""


Check = Callable[[NDArray[np.int64], Array, int], Findings | None]
"""Takes stamps (N,) [ns], the messages' `values()` (N, WIDTH) and the start of the recording [ns].

Returns None if the topic has no such values.
"""


@dataclass(frozen=True)
class Kind:
    """What is known of one kind of measurement.

    Attributes:
        name: the `kind` of its sensors in the configuration.
        message: what it is decoded to.
        decoders: type of a ROS message, as in ROS 2 -> what makes a decoder of it.
        columns: those of its CSV files; None if it has no such files.
        rules: how `holdfast config init` finds its topics; without a rule it proposes none.
        gap: what follows from a gap in its messages, for `holdfast info`.
        needs_config: a message cannot be decoded without the configuration of its sensor.
        check: finds values that a sensor cannot mean, for `holdfast info`.
        rank: its place among the kinds. The first kind that a type or a header fits is what a topic is without a
            configuration, and of rules that are alike the first one chooses.
    """

    name: str
    message: type[Message]
    decoders: Mapping[str, DecoderFactory] = field(default_factory=dict)
    columns: Columns | None = None
    rules: tuple[Rule, ...] = ()
    gap: str = "the estimate goes on without it meanwhile"
    needs_config: bool = False
    check: Check | None = None
    rank: int = 100

    @property
    def types(self) -> Collection[str]:
        """The message types that it can be decoded from."""
        return self.decoders.keys()

    @property
    def csv_type(self) -> str:
        """The type under which its CSV files are listed: the first that it can be decoded from."""
        return next(iter(self.decoders), self.name)


KINDS: dict[str, Kind] = {}


def register(kind: Kind) -> None:
    """Make a kind known, in its place by rank; it replaces one of the same name."""
    KINDS[kind.name] = kind
    ordered = sorted(KINDS.values(), key=lambda known: known.rank)
    KINDS.clear()
    KINDS.update({known.name: known for known in ordered})


def kinds_of(type_name: str) -> list[Kind]:
    """Return the kinds that a message type can be decoded to."""
    return [kind for kind in KINDS.values() if type_name in kind.decoders]


def make_decoder(subscription: Subscription, type_name: str, file: str) -> Decoder:
    """Return the decoder for messages of a type as the kind that is subscribed.

    Raises:
        RecordingError: no decoder makes that kind of that type.
    """
    allowed = KINDS[subscription.kind].decoders
    if type_name not in allowed:
        raise RecordingError(
            f"{file}: topic {subscription.topic!r} is {type_name}, which is no {subscription.kind} "
            f"(allowed: {', '.join(allowed) or 'none, only CSV files'})"
        )
    return allowed[type_name](subscription)


def default_decoder(topic: str, type_name: str) -> Decoder | None:
    """Return a decoder for the first kind that a type can be, or None; the messages carry the topic as sensor."""
    for kind in kinds_of(type_name):
        return None if kind.needs_config else kind.decoders[type_name](Subscription(topic, topic, kind.name))
    return None


for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
