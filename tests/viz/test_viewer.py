"""The viewer's window."""

import os
import socket
import subprocess
import sys
import time

import pytest

from holdfast.viz import viewer


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_the_viewer_listens_on_this_machine_only(monkeypatch):
    monkeypatch.setattr(viewer, "PORT", free_port())
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    # its server alone: a window needs a display
    process = subprocess.Popen([*viewer.command(), "--serve-grpc"], env=environment, stderr=subprocess.DEVNULL)
    try:
        end = time.monotonic() + 30.0
        while not viewer._listens() and time.monotonic() < end:
            time.sleep(0.05)
        assert listening(viewer.PORT) == ["127.0.0.1"]
        assert viewer.open_viewer() == f"rerun+http://127.0.0.1:{viewer.PORT}/proxy"  # one that is open is used
    finally:
        process.kill()
        process.wait()


def test_a_viewer_that_cannot_open_a_window_is_one_line(monkeypatch):
    monkeypatch.setattr(viewer, "PORT", free_port())
    monkeypatch.setattr(viewer, "command", lambda: [sys.executable, "-c", "raise SystemExit(3)"])
    with pytest.raises(viewer.ConfigError, match=r"^the viewer ended at once \(exit code 3\): is there a display\?$"):
        viewer.open_viewer()


def listening(port):
    """Addresses on which somebody listens at a TCP port."""
    found = []
    for table in ("tcp", "tcp6"):
        with open(f"/proc/net/{table}") as rows:  # noqa: PTH123
            for row in list(rows)[1:]:
                local, state = row.split()[1], row.split()[3]
                address, number = local.split(":")
                if state == "0A" and int(number, 16) == port:
                    packed = bytes.fromhex(address)
                    found.append(socket.inet_ntop(socket.AF_INET, packed[::-1]) if table == "tcp" else address)
    return found
