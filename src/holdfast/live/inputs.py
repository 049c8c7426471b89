"""From samples on the network to measurements, by the decoders of recordings; no sample is fatal."""

from collections import Counter
from collections.abc import Iterable, Sequence

from holdfast.errors import ConfigError
from holdfast.live.dds import Network, Publication, Sample
from holdfast.live.idl import STORE
from holdfast.messages import Message
from holdfast.printable import quoted
from holdfast.recording.decode import Decoder
from holdfast.recording.kinds import KINDS
from holdfast.recording.kinds.scans import POINT_CLOUD
from holdfast.recording.source import Subscription
from holdfast.ros.names import check_topic

SCANS_DEPTH = 4
"""Scans that wait in the network while the node is held up: each may be of 6 MB, and only the newest is wanted."""


class Inputs:
    """Subscribes to the topics of the sensors and decodes what arrives.

    A topic that may have one of several types is subscribed to once somebody publishes one of them.

    Args:
        network: where to subscribe.
        subscriptions: of the sensors; topics in full.
        reliable: ask for lost samples again.

    Raises:
        ConfigError: ROS has no such topic, or no message type can serve all the sensors that name one, or serve a
            sensor at all.
    """

    def __init__(self, network: Network, subscriptions: Sequence[Subscription], *, reliable: bool = False) -> None:
        self._network = network
        self._reliable = reliable
        self._decoders: dict[tuple[str, str], list[Decoder]] = {}
        self.malformed: Counter[str] = Counter()
        self.received: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}
        self.topics: dict[str, tuple[str, ...]] = {}
        self.sensors: dict[str, list[str]] = {}
        self.shed: Counter[str] = Counter()
        for subscription in subscriptions:
            check_topic(f"sensors.{subscription.sensor}.topic", subscription.topic)
            allowed = KINDS[subscription.kind].decoders
            known = self.topics.get(subscription.topic)
            types = tuple(allowed) if known is None else tuple(name for name in known if name in allowed)
            if not allowed:
                raise ConfigError(f"sensors.{subscription.sensor}.kind: {subscription.kind} has no message types")
            if not types:
                raise ConfigError(
                    f"sensors.{subscription.sensor}.topic: {subscription.topic} is that of another sensor"
                )
            self.topics[subscription.topic] = types
            self.sensors.setdefault(subscription.topic, []).append(subscription.sensor)
            for type_name in types:
                self._decoders.setdefault((subscription.topic, type_name), []).append(allowed[type_name](subscription))
        for topic, types in self.topics.items():
            if len(types) == 1:
                self._subscribe(topic, types[0])

    def join(self, publications: Iterable[Publication]) -> None:
        """Subscribe to the types that are published, where a topic may have several."""
        for publication in publications:
            if publication.type_name in self.topics.get(publication.topic, ()):
                self._subscribe(publication.topic, publication.type_name)

    def _subscribe(self, topic: str, type_name: str) -> None:
        if type_name == POINT_CLOUD:
            self._network.subscribe(topic, type_name, reliable=self._reliable, depth=SCANS_DEPTH)
        else:
            self._network.subscribe(topic, type_name, reliable=self._reliable)

    def decode(self, sample: Sample, arrival_ns: int) -> list[Message]:
        """Return the measurements in a sample; one that cannot be read is counted, with the reason of the last one.

        Args:
            sample: of any topic; of one that is no sensor's, nothing is returned.
            arrival_ns: when it arrived.
        """
        decoders = self._decoders.get((sample.topic, sample.type_name))
        if decoders is None:
            return []
        self.received[sample.topic] += 1
        try:
            content = STORE.deserialize_cdr(sample.data, sample.type_name)
        except Exception as error:  # damaged bytes raise anything; one sample must not end the node
            self._count_malformed(sample.topic, error)
            return []
        messages = []
        for decode in decoders:  # of several sensors: what is none of one may well be another
            try:
                messages.append(decode(content, arrival_ns))
            except Exception as error:
                self._count_malformed(sample.topic, error)
        return messages

    def _count_malformed(self, topic: str, error: Exception) -> None:
        self.malformed[topic] += 1
        self.reasons[topic] = quoted(error) or type(error).__name__
