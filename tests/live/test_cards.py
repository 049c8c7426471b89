"""What the sockets of DDS receive: only what comes over the configured network card, or from this machine."""

import os
import select
import socket
import sys
from pathlib import Path

import pytest
from network import LOOPBACK

from holdfast.config.live import LiveConfig
from holdfast.live.cards import has_filter, keeping_to, receive_only_over
from holdfast.live.dds import Network

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the filter is Linux's")


def open_to_all():
    """The UDP sockets of this process that are bound to every address, each with whether it has a filter."""
    found = {}
    for entry in Path("/proc/self/fd").iterdir():
        try:
            with socket.socket(fileno=os.dup(int(entry.name))) as opened:
                if opened.type == socket.SOCK_DGRAM and opened.getsockname()[0] in ("0.0.0.0", "::"):
                    found[opened.getsockname()[1]] = has_filter(opened)
        except OSError:
            continue
    return found


def test_with_an_interface_no_socket_is_left_that_hears_other_cards(domain):
    before = open_to_all()
    with Network(LiveConfig(domain_id=domain, **LOOPBACK)):
        opened = {port: filtered for port, filtered in open_to_all().items() if port not in before}
        assert opened  # Cyclone binds to every address: this is why there is a filter
        assert all(opened.values()), opened


def test_without_an_interface_nothing_is_filtered(domain):
    before = open_to_all()
    with Network(LiveConfig(domain_id=domain, multicast=False, peers=("localhost",))):
        opened = {port: filtered for port, filtered in open_to_all().items() if port not in before}
        assert opened and not any(opened.values())


@pytest.mark.parametrize(("cards", "is_received"), [
    (["lo"], True),
    (["other"], False),
    (["other", "lo"], True),
])  # fmt: skip
def test_the_kernel_drops_what_comes_over_another_card(cards, is_received):
    numbers = {"lo": socket.if_nametoindex("lo"), "other": 4242}
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.bind(("0.0.0.0", 0))
        receive_only_over(receiver, {numbers[name] for name in cards})
        sender.sendto(b"x" * 100, ("127.0.0.1", receiver.getsockname()[1]))
        readable, _, _ = select.select([receiver], [], [], 0.5)
        assert bool(readable) is is_received
        assert not readable or len(receiver.recv(200)) == 100


def test_sockets_that_were_there_before_are_left_alone():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mine:
        mine.bind(("0.0.0.0", 0))
        with keeping_to("lo"):
            new = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with new:
            assert has_filter(new) and not has_filter(mine)
