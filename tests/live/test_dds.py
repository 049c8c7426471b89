"""How the node joins the network."""

import socket
from pathlib import Path
from xml.etree import ElementTree

import pytest
from network import LOOPBACK

from holdfast.config.live import LiveConfig
from holdfast.config.load import load_config
from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.live.dds import Network, configuration, domain_id
from holdfast.live.node import full_name


def test_type_information_of_fast_dds_is_ignored_whatever_else_is_set(monkeypatch):
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    for live in (LiveConfig(), LiveConfig(**LOOPBACK), LiveConfig(peers=("10.0.0.7", "10.0.0.8"))):
        tree = ElementTree.fromstring(configuration(live))
        assert tree.findtext("Domain/Compatibility/IgnoreTypeInformation") == "1.15"
        assert [peer.get("Address") for peer in tree.iter("Peer")] == list(live.peers)


def test_interface_and_multicast_are_those_of_the_configuration():
    tree = ElementTree.fromstring(configuration(LiveConfig(**LOOPBACK)))
    assert [card.get("name") for card in tree.iter("NetworkInterface")] == ["lo"]
    assert tree.findtext("Domain/General/AllowMulticast") == "false"
    assert ElementTree.fromstring(configuration(LiveConfig())).findtext("Domain/General/AllowMulticast") is None


def test_what_the_user_told_cyclone_is_kept(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "file:///etc/cyclone.xml")
    assert configuration(LiveConfig()).startswith("file:///etc/cyclone.xml,<CycloneDDS>")


def test_an_unknown_network_card_is_refused_with_those_that_there_are():
    cards = [name for _, name in socket.if_nameindex()]
    with pytest.raises(ConfigError, match=r"live.interface = nowhere0") as caught:
        Network(LiveConfig(interface="nowhere0"))
    assert all(name in str(caught.value) for name in cards)


@pytest.mark.parametrize(("configured", "environment", "expected"), [
    (7, "8", 7),
    (None, "8", 8),
    (None, "", 0),
    (None, None, 0),
])  # fmt: skip
def test_the_domain_is_that_of_the_file_or_else_of_ros(monkeypatch, configured, environment, expected):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    if environment is not None:
        monkeypatch.setenv("ROS_DOMAIN_ID", environment)
    assert domain_id(LiveConfig(domain_id=configured)) == expected


@pytest.mark.parametrize("environment", ["-1", "233", "x", "1.5", "²"])
def test_a_domain_that_is_none_is_refused(monkeypatch, environment):
    monkeypatch.setenv("ROS_DOMAIN_ID", environment)
    with pytest.raises(ConfigError, match="ROS_DOMAIN_ID"):
        domain_id(LiveConfig())


@pytest.mark.parametrize(("topic", "namespace", "expected"), [
    ("/imu/data", "/machine", "/imu/data"),
    ("imu/data", "/machine", "/machine/imu/data"),
    ("imu/data", "", "/imu/data"),
])  # fmt: skip
def test_a_topic_without_a_leading_slash_belongs_to_the_namespace(topic, namespace, expected):
    assert full_name(topic, namespace) == expected


@pytest.mark.parametrize("wrong", [{"namespace": "machine"}, {"namespace": "/"}, {"node_name": "hold fast"}])
def test_names_that_ros_would_refuse_are_refused(wrong):
    with pytest.raises(ValueError, match="pattern"):
        Config.model_validate({"sensors": {"imu": {"kind": "imu", "topic": "/imu"}}, "live": wrong})


def test_the_example_is_a_valid_configuration():
    config = load_config(Path(__file__).parents[2] / "examples" / "live.yaml")
    assert config.has_base() and config.live.namespace == "/excavator"
