"""The viewer's window."""

import os
import socket
import subprocess
import sys
import time

import pytest

from holdfast.errors import ConfigError
from holdfast.viz import viewer
from holdfast.viz.show import close_sink, open_sink


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
    monkeypatch.setenv("DISPLAY", ":77")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    ends = r"^the viewer ended at once \(exit code 3\): is there a display DISPLAY=:77\?$"
    with pytest.raises(viewer.ConfigError, match=ends):
        viewer.open_viewer()


def test_a_viewer_that_ends_after_it_began_to_listen_is_one_line(monkeypatch):
    """As it does where its display is not there: all was drawn to nobody, or ended in a traceback."""
    monkeypatch.setattr(viewer, "PORT", free_port())
    listens = "import socket, time; s = socket.create_server(('127.0.0.1', %d)); time.sleep(0.4)"
    monkeypatch.setattr(viewer, "command", lambda: [sys.executable, "-c", listens % viewer.PORT])
    with pytest.raises(viewer.ConfigError, match=r"ended at once \(exit code 0\): is there a display"):
        viewer.open_viewer()


@pytest.mark.parametrize(("url", "words"), [
    ("rerun+http://127.0.0.1:{port}/proxy", "no viewer listens there"),
    ("rerun+http://127.0.0.1:99999/proxy", "must be rerun"),
    ("rerun+http://127.0.0.1/proxy", "must be rerun"),
    ("rerun+http://", "must be rerun"),
])  # fmt: skip
def test_an_address_at_which_no_viewer_listens_is_refused_at_once(url, words):
    url = url.format(port=free_port())
    began = time.monotonic()
    with pytest.raises(viewer.ConfigError, match=words) as refused:
        viewer.check_viewer(url)
    assert str(refused.value).startswith(url) and time.monotonic() - began < 2.0


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


def test_a_recording_whose_name_is_no_utf8_is_shown(tmp_path):
    close_sink(open_sink(str(tmp_path / "a.rrd"), "gr\udcf6sse"), str(tmp_path / "a.rrd"))
    assert (tmp_path / "a.rrd").stat().st_size > 0


class Full:
    def flush(self, **_):
        raise RuntimeError("the writer shut down")


@pytest.mark.parametrize(("target", "hint"), [("a.rrd", "is the disk full"), ("rerun+http://a:1/proxy", "does the vi")])
def test_what_cannot_be_drawn_tells_where_to_look(target, hint):
    """A file on a full disk asked whether the viewer runs."""
    with pytest.raises(ConfigError, match=f"not all could be drawn .the writer shut down.: {hint}"):
        close_sink(Full(), target)
