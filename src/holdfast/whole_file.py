"""A file that is there whole or not at all, whatever ends the writing: a full disk, Ctrl-C, a power cut."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import copymode

from holdfast.output_folder import naming_the_output

STREAMS = Path("/dev"), Path("/proc")  # where a name may be that of a pipe, which cannot be replaced


def write_whole(file: str | Path, text: str) -> None:
    """Write a file whole or not at all; names of other files in it may be no UTF-8.

    Raises:
        ConfigError: it cannot be written; names it, not its part, of which nobody knows.
    """
    with whole(file) as part:
        part.write_text(text, encoding="utf-8", errors="backslashreplace")


@contextmanager
def whole(file: str | Path) -> Iterator[Path]:
    """Give a part to be written, which becomes the file when the block ends, unless that raises.

    The part has the suffix of the file. A link stays one, and a file keeps who may read it. What is no file, such as
    /dev/stdout, is written itself.

    Raises:
        ConfigError: it cannot be written; names it, not its part.
    """
    with naming_the_output(file):
        try:
            if _is_stream(Path(file)):
                yield Path(file)
            else:
                with _part_of(Path(os.path.realpath(file))) as part:
                    yield part
        except OSError as error:
            error.filename = file
            raise


def _is_stream(file: Path) -> bool:
    is_there = any(file.absolute().is_relative_to(folder) for folder in STREAMS)
    return is_there or (file.exists() and not file.is_file())


@contextmanager
def _part_of(place: Path) -> Iterator[Path]:
    part = place.with_name(f".{place.stem}.{os.getpid()}.part{place.suffix}")
    try:
        yield part
        _put(part, place)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _put(part: Path, place: Path) -> None:
    """Put a part in the place of a file, once the disk has it."""
    with part.open("rb") as written:
        os.fsync(written.fileno())
    if place.exists():
        copymode(place, part)
    part.replace(place)
