"""The ROS 2 network over DDS, without a ROS installation: raw CDR in, raw CDR out.

Two settings make ROS' own DDS match, and where they are missing nothing reports it: samples are CDR version 1, and the
type information of eProsima's Fast DDS (vendor 1.15) is not compared with ours.
"""

import os
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, NamedTuple
from uuid import UUID
from xml.sax.saxutils import quoteattr

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from holdfast.config.live import LiveConfig
from holdfast.errors import ConfigError
from holdfast.live.cards import keeping_to
from holdfast.live.idl import dds_type, ros_name
from holdfast.printable import quoted
from holdfast.recording.source import Closing

ANY = SampleState.Any | ViewState.Any | InstanceState.Any
INPUT_DEPTH = 2000
"""Samples that wait per topic while the process is held up: 5 s of an IMU at 400 Hz."""
OUTPUT_DEPTH = 100
"""Messages that a reader which is held up for a second still gets."""
TAKE = 200
MAX_BLOCKING_MS = 1
"""No reader that has fallen asleep may hold up the IMU path."""
MAX_DOMAIN_ID = 232
UNLIMITED = -1


class Sample(NamedTuple):
    """One message as it was received: its CDR, undecoded."""

    topic: str
    type_name: str
    data: bytes


class Publication(NamedTuple):
    """Someone else on the network who publishes a topic."""

    topic: str
    type_name: str
    reliable: bool


Publish = Callable[[bytes], None]


class Network(Closing):
    """One participant on the ROS 2 network; a context manager.

    Topics are names as in ROS (`/imu/data`), types as well (`sensor_msgs/msg/Imu`).

    Raises:
        ConfigError: the network card does not exist, or DDS cannot use what the configuration asks for.
    """

    def __init__(self, live: LiveConfig) -> None:
        self.domain_id = domain_id(live)
        try:
            with keeping_to(live.interface) if live.interface is not None else nullcontext():
                self._domain = Domain(self.domain_id, configuration(live))
                self._participant = DomainParticipant(self.domain_id)
        except DDSException as error:
            raise ConfigError(f"live: DDS cannot join domain {self.domain_id} ({error.msg})") from None
        self._waiting = WaitSet(self._participant)
        self._readers: dict[tuple[str, str], tuple[DataReader[Any], ReadCondition]] = {}
        self._writers: list[DataWriter[Any]] = []
        self._discovery = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._discovered: dict[UUID, Publication] = {}
        self.unsent: Counter[str] = Counter()

    def subscribe(
        self,
        topic: str,
        type_name: str,
        *,
        reliable: bool = False,
        latched: bool = False,
        depth: int = INPUT_DEPTH,
    ) -> None:
        """Listen to a topic; to listen twice does no harm.

        Args:
            topic: in full, such as `/imu/data`.
            type_name: of a standard message.
            reliable: ask for lost samples again; such a reader does not match a best-effort publisher.
            latched: ask for the last samples that were published before.
            depth: samples that wait while the process is held up.
        """
        if (topic, type_name) in self._readers:
            return
        policies = [Policy.History.KeepLast(depth), *_policies(reliable=reliable, latched=latched)]
        reader = DataReader(self._participant, self._topic(topic, type_name), Qos(*policies))
        arrived = ReadCondition(reader, SampleState.NotRead | ViewState.Any | InstanceState.Any)
        self._waiting.attach(arrived)
        self._readers[topic, type_name] = (reader, arrived)

    def advertise(self, topic: str, type_name: str, *, latched: bool = False, depth: int = OUTPUT_DEPTH) -> Publish:
        """Publish a topic reliably, and return what publishes one message given as CDR.

        Args:
            topic: in full.
            type_name: of a standard message.
            latched: who comes later gets the messages that are kept.
            depth: messages that are kept, also for readers which lost some.
        """
        policies = [Policy.History.KeepLast(depth), *_policies(reliable=True, latched=latched)]
        if latched:
            policies.append(
                Policy.DurabilityService(0, Policy.History.KeepLast(depth), UNLIMITED, UNLIMITED, UNLIMITED)
            )
        writer = DataWriter(self._participant, self._topic(topic, type_name), Qos(*policies))
        self._writers.append(writer)
        reference = writer._ref

        def publish(data: bytes) -> None:
            if ddspy_write(reference, data.ljust((len(data) + 3) & ~3, b"\0")) != 0:
                self.unsent[topic] += 1  # a reader that has fallen asleep keeps the writer's memory full

        return publish

    def wait(self, timeout_s: float) -> list[Sample]:
        """Return what has arrived, after `timeout_s` at the latest; topics in the order of their subscription."""
        self._waiting.wait(duration(seconds=timeout_s))
        samples = []
        for (topic, type_name), (reader, _) in self._readers.items():
            while taken := ddspy_take(reader._ref, ANY, TAKE):
                if isinstance(taken, int):
                    raise DDSException(taken, f"taking {topic}")
                samples += [Sample(topic, type_name, data) for data, info in taken if info.valid_data]
                if len(taken) < TAKE:
                    break
        return samples

    def publications(self) -> list[Publication]:
        """Return who else publishes what on this network now."""
        for endpoint in self._discovery.take(TAKE):
            if endpoint.sample_info.instance_state != InstanceState.Alive:
                self._discovered.pop(endpoint.key, None)
            elif endpoint.participant_key != self._participant.guid and endpoint.topic_name.startswith("rt/"):
                self._discovered[endpoint.key] = Publication(
                    quoted(endpoint.topic_name.removeprefix("rt")),
                    quoted(ros_name(endpoint.type_name)),
                    endpoint.qos[Policy.Reliability] != Policy.Reliability.BestEffort,
                )
        return list(self._discovered.values())

    def close(self) -> None:
        """Leave the network."""
        self._readers.clear()
        self._writers.clear()
        self._participant.__del__()
        self._domain.__del__()

    def _topic(self, topic: str, type_name: str) -> Topic[Any]:
        return Topic(self._participant, f"rt{topic}", dds_type(type_name))


def _policies(*, reliable: bool, latched: bool) -> list[Any]:
    return [
        Policy.Reliability.Reliable(duration(milliseconds=MAX_BLOCKING_MS))
        if reliable
        else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.DataRepresentation(use_cdrv0_representation=True),
    ]


def domain_id(live: LiveConfig) -> int:
    """Return the domain: that of the configuration, or else of ROS_DOMAIN_ID, or else 0.

    Raises:
        ConfigError: ROS_DOMAIN_ID is no domain.
    """
    if live.domain_id is not None:
        return live.domain_id
    given = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not given.isascii() or not given.isdigit() or int(given) > MAX_DOMAIN_ID:
        raise ConfigError(f"ROS_DOMAIN_ID = {given}: must be a whole number from 0 to {MAX_DOMAIN_ID}")
    return int(given)


def configuration(live: LiveConfig) -> str:
    """Return the configuration of Cyclone DDS; that of CYCLONEDDS_URI is read before ours.

    Raises:
        ConfigError: this machine has no such network card.
    """
    general, discovery = "", ""
    if live.interface is not None:
        cards = [name for _, name in socket.if_nameindex()]
        if live.interface not in cards:
            raise ConfigError(f"live.interface = {live.interface}: this machine has {', '.join(cards)}")
        general += f"<Interfaces><NetworkInterface name={quoteattr(live.interface)}/></Interfaces>"
    if not live.multicast:
        general += "<AllowMulticast>false</AllowMulticast>"
        discovery += "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>40</MaxAutoParticipantIndex>"
    if live.peers:
        peers = "".join(f"<Peer Address={quoteattr(peer)}/>" for peer in live.peers)
        discovery += f"<Peers>{peers}</Peers>"
    ours = (
        f"<CycloneDDS><Domain Id='any'><General>{general}</General><Discovery>{discovery}</Discovery>"
        "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility></Domain></CycloneDDS>"
    )
    theirs = os.environ.get("CYCLONEDDS_URI")
    return f"{theirs},{ours}" if theirs else ours
