"""Opens the viewer of Rerun, so that only this machine can send to it.

`RecordingStream.spawn` of the SDK binds the viewer's port to every address; the viewer's own command can do better.
"""

import os
import socket
import subprocess
import sys
from time import monotonic, sleep

from holdfast.errors import ConfigError

HOST, PORT = "127.0.0.1", 9876
START_S = 30.0


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
    until_s = monotonic() + START_S
    while not _listens():
        if process.poll() is not None:
            raise ConfigError(f"the viewer ended at once (exit code {process.returncode}): is there a display?")
        if monotonic() > until_s:
            process.kill()
            raise ConfigError(f"the viewer does not listen on {HOST}:{PORT} after {START_S:g} s")
        sleep(0.05)
    return url


def command() -> list[str]:
    """Return the command that opens the viewer."""
    return [sys.executable, "-m", "rerun_cli", "--bind", HOST, "--port", str(PORT), "--expect-data-soon"]


def _listens() -> bool:
    with socket.socket() as probe:
        probe.settimeout(0.2)
        return probe.connect_ex((HOST, PORT)) == 0
