"""The other side of the network: `holdfast live` in a process, and a machine that publishes a simulated drive."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML

from holdfast.config.live import LiveConfig
from holdfast.live.dds import Network
from holdfast.live.idl import STORE

LOOPBACK = {"interface": "lo", "multicast": False, "peers": ["localhost"]}
RUN = "from holdfast.cli import main; main()"
START_S = 30.0  # to import everything on a busy machine


def network(domain):
    """Join the domain from this process."""
    return Network(LiveConfig(domain_id=domain, **LOOPBACK))


class LiveProcess:
    """`holdfast live` in a process of its own; its words are in `lines()`."""

    def __init__(self, folder, domain, *arguments, config=None, limit_bytes=None, **live):
        content = YAML(typ="safe").load((drive() / "config.yaml").read_text()) if config is None else config
        content["live"] = LOOPBACK | {"domain_id": domain} | live
        path = folder / "live.yaml"
        path.write_text(json.dumps(content))
        self.config = str(path)
        self._log = folder / "live.log"
        code = (
            RUN
            if limit_bytes is None
            else f"import resource as r; r.setrlimit(r.RLIMIT_FSIZE, ({limit_bytes},) * 2); {RUN}"
        )
        command = [sys.executable, "-c", code, "live", "-c", str(path), *map(str, arguments)]
        with self._log.open("w") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)

    def lines(self):
        return self._log.read_text().splitlines()

    def wait_for(self, text, timeout_s=START_S):
        """Wait until a line holds the text, and return it."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            found = [line for line in self.lines() if text in line]
            if found:
                return found[0]
            assert self.process.poll() is None, self.lines()
            time.sleep(0.02)
        raise AssertionError(f"{text!r} was never printed: {self.lines()}")

    def end(self, number=signal.SIGINT, timeout_s=30.0):
        """End it as a terminal does, the whole group at once, and return its exit code."""
        os.killpg(self.process.pid, number)
        return self.process.wait(timeout_s)

    def kill(self):
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


@cache
def drive():
    """A simulated drive, made once per session."""
    from tempfile import mkdtemp

    folder = Path(mkdtemp(prefix="holdfast-live-")) / "quick"
    done = subprocess.run(
        [sys.executable, "-c", RUN, "simulate", "quick", "-o", str(folder)], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder


def messages(recording, topics=None):
    """(time [ns], topic, type, CDR, message) of a recording, in order."""
    with AnyReader([Path(recording)]) as reader:
        wanted = [c for c in reader.connections if topics is None or c.topic in topics]
        for connection, at, raw in reader.messages(wanted):
            message = reader.deserialize(raw, connection.msgtype)
            yield at, connection.topic, connection.msgtype, bytes(raw), message


def plain(value):
    """A message as plain values, without the constants of its type."""
    if hasattr(value, "__msgtype__"):
        names = (name for _, fields in [STORE.fielddefs[value.__msgtype__]] for name, _ in fields)
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(entry) for entry in value] if isinstance(value, list) else value


class Machine:
    """Plays the drive from this process, as drivers would."""

    def __init__(self, network, topics):
        self.network = network
        self.publishers = {topic: network.advertise(topic, name) for topic, name in topics.items()}

    def play(self, begin_s, end_s):
        """Publish what arrived in this time of the drive, at its pace and with stamps of now; return what came back."""
        rows = list(messages(drive() / "recording.mcap", self.publishers))
        first_ns, received = rows[0][0], []
        began, shift_ns = time.monotonic(), time.time_ns() - first_ns - round(begin_s * 1e9)
        for at_ns, topic, name, _, message in rows:
            at_s = (at_ns - first_ns) * 1e-9
            if begin_s <= at_s < end_s:
                received += self.receive(began + at_s - begin_s)
                self.publishers[topic](stamped(message, name, shift_ns))
        return received

    def receive(self, until):
        """Return the samples that come until a time of the monotonic clock."""
        received = []
        while (left := until - time.monotonic()) > 0:
            received += self.network.wait(left)
        return received


def stamped(message, name, shift_ns):
    """Move the stamp of a message and return its CDR."""
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp.sec * 10**9 + stamp.nanosec + shift_ns, 10**9)
    return bytes(STORE.serialize_cdr(message, name))
