"""A process that ends with the one that started it, however that one ended."""

import os
import signal
import sys
from threading import Thread


def end_with_parent() -> None:
    """Ask this process to end, as a service manager does, when its standard input ends: its parent holds the pipe."""
    Thread(target=_watch, name="parent", daemon=True).start()


def die_with_parent() -> None:
    """Let the kernel end this process with the one that started it, even while it is stopped or busy (Linux)."""
    if sys.platform == "linux":
        import ctypes

        parent = os.getppid()
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
        if os.getppid() != parent:
            sys.exit(0)


def _watch() -> None:
    try:
        while os.read(sys.stdin.fileno(), 1):
            pass
    finally:
        os.kill(os.getpid(), signal.SIGTERM)
