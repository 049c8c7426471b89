"""Keeps the sockets of DDS to one network card.

Cyclone DDS binds the ports on which it receives to every address, whatever `NetworkInterface` says: that setting only
chooses from which card it sends and where it joins multicast. So a filter in the kernel drops what comes in over
another card, before this process sees it. The card `lo` is always let through: over it come the nodes of this machine.
"""

import ctypes
import os
import socket
import struct
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

LOOPBACK = "lo"
SO_ATTACH_FILTER, SO_GET_FILTER = 26, 26  # asm-generic/socket.h
LOAD_WORD, JUMP_IF_EQUAL, RETURN = 0x20, 0x15, 0x06  # linux/bpf_common.h
CARD_OF_PACKET = 0xFFFFF000 + 8  # SKF_AD_OFF + SKF_AD_IFINDEX
ALL = 0xFFFFFFFF
INSTRUCTION = struct.Struct("HBBI")
PROGRAM = struct.Struct("HP")


@contextmanager
def keeping_to(card: str) -> Iterator[None]:
    """Let the UDP sockets that are opened meanwhile receive over one network card and `lo` only (Linux).

    Raises:
        OSError: there is no such card.
    """
    before = set(_udp_sockets())
    yield
    if not sys.platform.startswith("linux"):
        return
    numbers = {socket.if_nametoindex(name) for name in (card, LOOPBACK)}
    for descriptor in set(_udp_sockets()) - before:
        with socket.socket(fileno=os.dup(descriptor)) as opened:
            receive_only_over(opened, numbers)


def receive_only_over(opened: socket.socket, cards: Collection[int]) -> None:
    """Make the kernel drop what a socket would receive over another card than these, given by their numbers."""
    program = [INSTRUCTION.pack(LOAD_WORD, 0, 0, CARD_OF_PACKET)]
    for left, number in zip(reversed(range(len(cards))), sorted(cards), strict=True):
        program.append(INSTRUCTION.pack(JUMP_IF_EQUAL, left + 1, 0, number))  # over the rest and the return of 0
    program += [INSTRUCTION.pack(RETURN, 0, 0, 0), INSTRUCTION.pack(RETURN, 0, 0, ALL)]
    code = ctypes.create_string_buffer(b"".join(program))
    opened.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, PROGRAM.pack(len(program), ctypes.addressof(code)))


def has_filter(opened: socket.socket) -> bool:
    """Return whether a socket has a filter."""
    return len(opened.getsockopt(socket.SOL_SOCKET, SO_GET_FILTER, 1024)) > 0


def _udp_sockets() -> Iterator[int]:
    """Yield the descriptors of the UDP sockets of this process; none where there is no /proc."""
    folder = Path("/proc/self/fd")
    for entry in folder.iterdir() if folder.is_dir() else ():
        try:
            if not str(entry.readlink()).startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(entry.name))) as opened:
                is_udp = opened.type == socket.SOCK_DGRAM and opened.family in (socket.AF_INET, socket.AF_INET6)
        except OSError:  # the descriptor with which the folder is read
            continue
        if is_udp:
            yield int(entry.name)
