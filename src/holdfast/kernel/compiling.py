"""Compiles the functions of this room with numba, once per machine.

Machine code is kept in a folder of its own for each version of this room's sources: numba by itself looks only at the
file of the function that is called, not at those of the functions that it calls. The folder lies where
`NUMBA_CACHE_DIR` says, or else among the user's caches; if it cannot be written there, among the temporary files; if
there neither, the code lives as long as the process.
"""

import logging
import os
import tempfile
from collections.abc import Callable
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numba

if TYPE_CHECKING:
    from collections.abc import Iterator

F = TypeVar("F", bound=Callable[..., Any])
Compiled = Callable[..., Any]

HERE = Path(__file__).parent
MESSAGE = "compiling the IMU path for this machine, once: about a minute"


def _among_caches() -> Path:
    return Path(os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _among_temporary_files() -> Path:
    """A folder that nobody else can write to: what lies in it is executed."""
    folder = Path(tempfile.gettempdir()) / f"holdfast-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise PermissionError(f"{folder} belongs to others")
    return folder


def _folder() -> Path | None:
    """Return where machine code is kept; None if it can be kept nowhere."""
    version = sha256(str(HERE).encode())
    for source in sorted(HERE.glob("*.py")):
        version.update(source.read_bytes())
    for place in (_among_caches, _among_temporary_files):
        with suppress(OSError, RuntimeError):  # there may be no home
            folder = place() / "holdfast" / version.hexdigest()[:16]
            is_new = not folder.exists()
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                if is_new:
                    logging.getLogger(__name__).warning(MESSAGE)
                return folder
    logging.getLogger(__name__).warning(f"{MESSAGE} (its cache cannot be written: each time)")
    return None


FOLDER = _folder()


@contextmanager
def _caching_here() -> "Iterator[None]":
    config: Any = numba.config
    before, config.CACHE_DIR = config.CACHE_DIR, str(FOLDER)
    try:
        yield
    finally:
        config.CACHE_DIR = before


def inner(function: F) -> F:
    """Compile a function with those that call it; Python cannot, which is a quarter of the work less."""
    options: Any = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}  # which the types of numba do not know
    with _caching_here():
        compiled: Any = numba.njit(error_model="numpy", cache=FOLDER is not None, **options)(function)
    return compiled


def entry(*signature: Any) -> Callable[[Compiled], Compiled]:
    """Compile a function that Python calls, for arguments of these types and no others, now.

    Args:
        signature: the type of what it returns, and those of its arguments.
    """

    def compiled(function: Compiled) -> Compiled:
        types = signature[0](*signature[1:])
        with _caching_here():
            made: Any = numba.njit(types, error_model="numpy", cache=FOLDER is not None)(function)
        entry_point: Compiled = made.get_overload(types)  # the types of what it is given are not looked at again
        return entry_point

    return compiled
