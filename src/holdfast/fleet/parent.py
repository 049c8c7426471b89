"""A process that ends with the one that started it, however that one ended."""

import os
import signal
import sys
from threading import Thread


def end_with_parent() -> None:
    """Ask this process to end, as a service manager does, when its standard input ends: its parent holds the pipe."""
    Thread(target=_watch, name="parent", daemon=True).start()


def _watch() -> None:
    try:
        while os.read(sys.stdin.fileno(), 1):
            pass
    finally:
        os.kill(os.getpid(), signal.SIGTERM)
