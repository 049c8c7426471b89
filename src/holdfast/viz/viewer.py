"""Opens the viewer of Rerun, so that only this machine can send to it.

`RecordingStream.spawn` of the SDK binds the viewer's port to every address; the viewer's own command can do better.
"""

import os
import socket
import subprocess
import sys
from time import monotonic, sleep
from urllib.parse import urlsplit

from holdfast.errors import ConfigError

DISPLAYS = "DISPLAY", "WAYLAND_DISPLAY"
HOST, PORT = "127.0.0.1", 9876
CONNECT_S = 3.0
START_S = 30.0
SETTLE_S = 1.0  # it listens before it opens its window, and ends where that fails


def open_viewer() -> str:
    """Open the viewer in a window, unless one is open already; return the address at which it listens.

    Raises:
        ConfigError: it ends at once, or does not listen.
    """
    url = f"rerun+http://{HOST}:{PORT}/proxy"
    if _listens():
        return url
    process = subprocess.Popen(
        command(),
        env=os.environ | {"RERUN_APP_ONLY": "true"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # it stays open when this process ends
    )
    until_s, settled_s = monotonic() + START_S, None
    while settled_s is None or monotonic() < settled_s:
        if process.poll() is not None:
            raise ConfigError(f"the viewer ended at once (exit code {process.returncode}): is there {a_display()}?")
        if settled_s is None and _listens():
            settled_s = monotonic() + SETTLE_S
        if monotonic() > until_s:
            process.kill()
            raise ConfigError(f"the viewer does not listen on {HOST}:{PORT} after {START_S:g} s")
        sleep(0.05)
    return url


def a_display() -> str:
    """Return the displays at which a window would open, as the environment names them, in words."""
    named = [f"{name}={os.environ[name]}" for name in DISPLAYS if os.environ.get(name)]
    return f"a display {' or '.join(named)}" if named else "a display"


def check_viewer(url: str) -> None:
    """Refuse an address at which nobody listens: the SDK would wait for long, and say so in lines of its own.

    Raises:
        ConfigError: nobody listens there.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:  # a port that is none
        raise ConfigError(f"{url}: {error}: must be rerun+http://HOST:PORT/proxy") from None
    if host is None or port is None:
        raise ConfigError(f"{url}: must be rerun+http://HOST:PORT/proxy")
    try:
        socket.create_connection((host, port), CONNECT_S).close()
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigError(f"{url}: no viewer listens there ({reason}): start one, or write a file *.rrd") from None


def command() -> list[str]:
    """Return the command that opens the viewer."""
    return [sys.executable, "-m", "rerun_cli", "--bind", HOST, "--port", str(PORT), "--expect-data-soon"]


def _listens() -> bool:
    with socket.socket() as probe:
        probe.settimeout(0.2)
        return probe.connect_ex((HOST, PORT)) == 0
