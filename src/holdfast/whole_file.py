"""A file that is there whole or not at all, whatever ends the writing: a full disk, Ctrl-C, a power cut."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import copymode

from holdfast.output_folder import naming_the_output

STREAMS = Path("/dev"), Path("/proc")  # where a name may be that of a pipe, which cannot be replaced


def write_whole(file: str | Path, content: str | bytes) -> None:
    """Write a file whole or not at all; names of other files in a text may be no UTF-8.

    Raises:
        ConfigError: it cannot be written; names it, not its part, of which nobody knows.
    """
    with whole(file) as part:
        part.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "backslashreplace"))


@contextmanager
def whole(file: str | Path) -> Iterator[Path]:
    """Give a part to be written, which becomes the file when the block ends, unless that raises.

    The part has the suffix of the file. A link stays one, and a file keeps who may read it. What is no file, such as
    /dev/stdout, is written itself.

    Raises:
        ConfigError: it cannot be written; names it, not its part.
    """
    named, place = Path(file), Path(os.path.realpath(file))
    is_stream = (named.exists() and not named.is_file()) or any(
        named.absolute().is_relative_to(folder) for folder in STREAMS
    )
    part = named if is_stream else place.with_name(f".{place.stem}.{os.getpid()}.part{place.suffix}")
    with naming_the_output(file):
        try:
            yield part
            if not is_stream:
                _put(part, place)
        except OSError as error:
            error.filename = file
            raise
        finally:
            if not is_stream:
                with suppress(OSError):
                    part.unlink(missing_ok=True)


def _put(part: Path, place: Path) -> None:
    """Put a part in the place of a file, once the disk has it."""
    with part.open("rb") as written:
        os.fsync(written.fileno())
    if place.exists():
        copymode(place, part)
    part.replace(place)
