"""The folder of a command's results: replaced as a whole, refused where it holds what Holdfast did not write.

Results are made where they belong, so that a run which is killed leaves there what it had computed, and nothing else.
Those of the run before wait beside them, in `.NAME.earlier`, until the new ones are complete; they come back where the
new run fails before it has written anything, and where there were none nothing is left. The file `.holdfast` in a
folder lists what Holdfast wrote into it.
"""

import fcntl
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from typing import NamedTuple

from holdfast.errors import ConfigError
from holdfast.printable import listed

MARK = ".holdfast"
BAG, BAG_KEY = "metadata.yaml", b"rosbag2_bagfile_information"
SIMULATE = "simulate"
OF_SEVERAL_RUNS = ("ablate", "batch", "paper")  # commands whose folders only they replace
HEADERS_BYTES = 4096  # that the files of a run may hold before any result is in them
SHOWN = 3  # names in an error


class Mark(NamedTuple):
    """What a folder says of itself: the command that wrote it, and what is in it; None while that is being written.

    `added` are the paths of the files that other commands wrote into it.
    """

    command: str
    files: tuple[str, ...] | None
    added: tuple[str, ...] = ()


NO_MARK = Mark("", ())


@contextmanager
def replaced(folder: str | Path, command: str, reads: Iterable[str | Path] = ()) -> Iterator[None]:
    """Make an empty folder for results; what an earlier run left there is gone when the block ends.

    Args:
        folder: of the results; it need not exist.
        command: that writes them, such as `replay`.
        reads: files and folders that are read meanwhile.

    Raises:
        ConfigError: `folder` is a file, holds or is part of what is read, holds what Holdfast did not write, results of
            other runs or of a command of several runs, or what another command simulated, or is being written by
            another process.
        OSError: it cannot be written.
        KeyboardInterrupt: as it came, with the folder in its text.
    """
    place = _checked(folder, reads, command)
    mark = _read_mark(place) or NO_MARK
    if mark.command in OF_SEVERAL_RUNS:
        _check_command(mark, folder, command)
    with _locked(place, folder):  # nobody else replaces what is about to be moved
        earlier = _set_aside(place)
    is_new = earlier is None and not place.exists()
    place.mkdir(parents=True, exist_ok=True)
    try:
        with _owned(place, folder, command):
            yield
    except BaseException as error:
        if _is_bare(place):
            _empty(place)
            if earlier is not None or is_new:
                place.rmdir()
            if earlier is not None:
                earlier.rename(place)
            if isinstance(error, KeyboardInterrupt):
                of_before = f", {folder} holds the results of before" * (earlier is not None)
                raise KeyboardInterrupt(f"nothing was done yet{of_before}") from None
        raise
    finally:
        if earlier is not None:
            rmtree(earlier, ignore_errors=True)


@contextmanager
def continued(folder: str | Path, command: str, reads: Iterable[str | Path] = ()) -> Iterator[None]:
    """Make or take up again a folder whose results are kept and added to; arguments and errors as in `replaced`.

    Raises:
        ConfigError: also for results of another command.
    """
    place = _checked(folder, reads, command)
    _check_command(_read_mark(place) or NO_MARK, folder, command)
    place.mkdir(parents=True, exist_ok=True)
    with _owned(place, folder, command):
        yield


@contextmanager
def naming_the_output(output: str | Path) -> Iterator[None]:
    """Report a full disk and other failures to write in one line.

    Raises:
        ConfigError: names the file, or the output if the system does not name one.
    """
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{error.filename or output}: cannot be written ({error.strerror or error})") from None


def check_folder_of(file: str | Path) -> None:
    """Refuse a file that cannot be written, before long work: a folder, or one in a folder that is not there.

    Raises:
        ConfigError: names the file.
    """
    if not Path(file).absolute().parent.is_dir():
        raise ConfigError(f"{file}: cannot be written (its folder does not exist)")
    if Path(file).is_dir():
        raise ConfigError(f"{file}: cannot be written (it is a folder)")


def check_output_file(file: str | Path, reads: Iterable[str | Path] = ()) -> None:
    """Refuse an output file that cannot be written, would overwrite what is read or what a run wrote, or lie in a bag.

    Raises:
        ConfigError: names both.
    """
    check_folder_of(file)
    place = _real(file)
    _check_reads(place, file, reads)
    folder, mark = _marked(place)
    if folder is None or not place.exists():
        return
    path = place.relative_to(folder)
    if path.parts[0] in {MARK, *(mark.files or ())} and str(path) not in mark.added:
        raise ConfigError(f"{file}: was written by holdfast {mark.command}, which keeps it: give another file")


def check_distinct(files: Iterable[tuple[str, str | Path]]) -> None:
    """Refuse two outputs that are one file, however it is written: the second would replace the first.

    Args:
        files: option and file of each.

    Raises:
        ConfigError: names them.
    """
    seen: dict[Path, str] = {}
    for option, file in files:
        place = _real(file)
        if place in seen:
            others = f" ({seen[place]} and {option})" * (seen[place] != option)
            raise ConfigError(f"{option} {file}: is given twice{others}")
        seen[place] = option


def add_results(*files: Path) -> None:
    """Note files that were written into a folder of results afterwards, so that they are replaced with it.

    Raises:
        ConfigError: that cannot be written.
    """
    for file in files:
        place = _real(file)
        folder, mark = _marked(place)
        if folder is not None and mark.files is not None:
            added = {*mark.added, str(place.relative_to(folder))}
            names = {*mark.files, place.name} if place.parent == folder else mark.files
            with naming_the_output(file):
                _write_mark(folder, Mark(mark.command, tuple(sorted(names)), tuple(sorted(added))))


def _marked(place: Path) -> tuple[Path | None, Mark]:
    """Return the innermost folder with a mark that holds a file, and the mark."""
    marks = ((folder, _read_mark(folder)) for folder in place.parents)
    return next(((folder, mark) for folder, mark in marks if mark is not None), (None, NO_MARK))


def _checked(folder: str | Path, reads: Iterable[str | Path], command: str) -> Path:
    place = _real(folder)
    if place.exists() and not place.is_dir():
        raise ConfigError(f"{folder}: is a file: the output must be a folder")
    _check_reads(place, folder, reads)
    _check_simulations(place, folder, command)
    _check_runs_above(place, folder, command)
    strange = _strangers(place) if place.exists() else []
    others = [name for name in strange if _read_mark(place / name) is None]
    if others:
        names = ", ".join(others[:SHOWN]) + ", ..." * (len(others) > SHOWN)
        raise ConfigError(f"{folder}: holds what Holdfast did not write ({names}): give another folder or an empty one")
    if strange:
        raise ConfigError(f"{folder}: holds results of other runs ({listed(strange, SHOWN)}): give another folder")
    return place


def _check_runs_above(place: Path, name: str | Path, command: str) -> None:
    """Refuse a folder in the results of another run, which go as a whole.

    Results may stand beside the files of the simulation that they are of, but another simulation may not.
    """
    folder, mark = _marked(place)
    is_of_its_jobs = mark.files is None and mark.command in (*OF_SEVERAL_RUNS, "")
    is_beside_recording = mark.command == SIMULATE != command
    if folder is not None and not is_beside_recording and not is_of_its_jobs:
        raise ConfigError(f"{name}: is in {folder}, the results of holdfast {mark.command}: give another folder")


def _check_command(mark: Mark, name: str | Path, command: str) -> None:
    """Refuse results of another command."""
    if mark.command and mark.command != command:
        raise ConfigError(
            f"{name}: holds results of holdfast {mark.command}: give another folder, or remove this one first"
        )


def _check_simulations(place: Path, name: str | Path, command: str) -> None:
    """Refuse to replace simulated recordings by anything but another simulation."""
    simulated = [one.name for one in place.iterdir() if _is_simulation(one)] if place.is_dir() else []
    if simulated:
        raise ConfigError(f"{name}: holds simulated recordings ({listed(simulated, SHOWN)}): give another folder")
    if command != SIMULATE and _is_simulation(place):
        raise ConfigError(f"{name}: is a simulated recording: give another folder, or one in it")


def _is_simulation(folder: Path) -> bool:
    return (_read_mark(folder) or NO_MARK).command == SIMULATE


def _real(path: str | Path) -> Path:
    return Path(os.path.realpath(path))  # a loop of links is an error of whoever opens it


def _check_reads(place: Path, name: str | Path, reads: Iterable[str | Path]) -> None:
    for read in reads:
        source = _real(read)
        if not source.exists():
            continue  # whoever reads it says so
        if place == source or place in source.parents:
            raise ConfigError(f"{name}: is or holds {read}, which is read: give another output")
        # results may stand in the folder of a simulation, which is no recorder's
        if source in place.parents and not _is_simulation(source):
            raise ConfigError(f"{name}: is in the recording {Path(read)}: give an output outside of it")
    bag = next((one for one in place.parents if _is_bag(one)), None)
    if bag is not None:
        raise ConfigError(f"{name}: is in the recording {bag}: give an output outside of it")


def _is_bag(folder: Path) -> bool:
    try:
        return BAG_KEY in (folder / BAG).read_bytes()
    except OSError:
        return False


def _strangers(place: Path) -> list[str]:
    """Return what the last run did not write into a folder; what it was writing when it was killed, it wrote."""
    mark = _read_mark(place) or NO_MARK
    if mark.files is None:
        return []
    mine = {MARK, *mark.files}
    return sorted(one.name for one in place.iterdir() if one.name not in mine)


def _read_mark(folder: Path) -> Mark | None:
    """Return what `_write_mark` wrote, or None if it did not; an empty one is of a run that was killed."""
    try:
        found = json.loads((folder / MARK).read_text(encoding="utf-8") or '{"command": "", "files": null}')
        files = None if found["files"] is None else tuple(map(str, found["files"]))
        return Mark(str(found["command"]), files, tuple(map(str, found.get("added", ()))))
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _write_mark(folder: Path, mark: Mark) -> None:
    (folder / MARK).write_text(json.dumps(mark._asdict()) + "\n", encoding="utf-8")


@contextmanager
def _owned(place: Path, name: str | Path, command: str) -> Iterator[None]:
    """Mark a folder as one that is being written, and at the end with what was written."""
    (place / MARK).touch()
    with _locked(place, name):
        added = (_read_mark(place) or NO_MARK).added
        _write_mark(place, Mark(command, None, added))
        try:
            yield
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"what was done until then is in {name}") from None
        finally:
            with suppress(OSError):  # a full disk, which has been reported
                names = sorted(one.name for one in place.iterdir() if one.name != MARK)
                _write_mark(place, Mark(command, tuple(names), added))


@contextmanager
def _locked(place: Path, name: str | Path) -> Iterator[None]:
    """Hold a folder that has a mark against other processes; the lock ends with this one, however that ends."""
    if not (place / MARK).exists():
        yield
        return
    with (place / MARK).open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"{name}: is being written by another process: give another folder, or wait") from None
        except OSError:
            pass  # a file system without locks
        yield


def _set_aside(place: Path) -> Path | None:
    """Move earlier results out of the way; where nothing can be moved they are deleted, and None is returned."""
    earlier = place.with_name(f".{place.name}.earlier")
    if _read_mark(earlier) is not None:  # of a run that was killed
        rmtree(earlier)
    if not place.exists() or not any(place.iterdir()):
        return None
    try:
        if place == Path.cwd() or place in Path.cwd().parents or earlier.exists():
            raise FileExistsError
        place.rename(earlier)
    except OSError:  # a mount point, a parent that is read-only
        _empty(place)
        return None
    return earlier


def _empty(place: Path) -> None:
    for one in place.iterdir():
        if one.is_dir() and not one.is_symlink():
            rmtree(one)
        else:
            one.unlink()


def _is_bare(place: Path) -> bool:
    """Whether a run has written no more than headers."""
    return sum(one.stat().st_size for one in place.rglob("*") if one.is_file() and one.name != MARK) < HEADERS_BYTES
