"""A file is there whole or not at all, and stays what it was: a link, private, or a stream."""

import os
import resource
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from holdfast.api.trajectory import Trajectory
from holdfast.errors import ConfigError
from holdfast.export.formats import write_csv
from holdfast.whole_file import whole, write_whole


@contextmanager
def full_disk(room_bytes):
    """No file can be longer, as where the disk is full."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def names(folder):
    return [one.name for one in folder.iterdir()]


@pytest.fixture
def file(tmp_path):
    (tmp_path / "page.html").write_text("before")
    return tmp_path / "page.html"


def test_a_full_disk_leaves_the_file_of_before_and_names_the_file(file):
    with full_disk(1000), pytest.raises(ConfigError, match=f"^{file}: cannot be written .File too large.$"):
        write_whole(file, "x" * 2000)
    assert file.read_text() == "before" and names(file.parent) == ["page.html"]


def test_an_interrupt_leaves_the_file_of_before(file):
    with pytest.raises(KeyboardInterrupt), whole(file) as part:
        part.write_text("half")
        raise KeyboardInterrupt
    assert file.read_text() == "before" and names(file.parent) == ["page.html"]


def test_the_part_has_the_suffix_of_the_file_by_which_libraries_tell_formats(file):
    with whole(file) as part:
        assert part.suffix == ".html" and part.parent == file.parent
        part.write_text("now")
    assert file.read_text() == "now"


def test_a_link_stays_one_and_a_private_file_private(file):
    file.chmod(0o600)
    link = file.with_name("link.html")
    link.symlink_to(file)
    write_whole(link, "now")
    assert link.is_symlink() and file.read_text() == "now" and file.stat().st_mode & 0o777 == 0o600


def test_a_stream_is_written_and_not_replaced(tmp_path):
    """As root, what was no file but a device became one."""
    write_whole("/dev/null", "x")
    assert not Path("/dev/null").is_file()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_whole(pipe, "numbers")
    assert os.read(reader, 100) == b"numbers"
    os.close(reader)


def test_a_track_that_does_not_fit_on_the_disk_leaves_the_one_of_before(tmp_path):
    def track(number):
        stamps_ns = np.arange(number) * 10**7
        return Trajectory(stamps_ns, np.zeros((number, 3)), np.tile([0.0, 0, 0, 1], (number, 1)))

    file = tmp_path / "track.tum"
    track(2).write(file)
    with full_disk(1000), pytest.raises(ConfigError, match=r"track\.tum: cannot be written"):
        track(100).write(file)
    assert len(Trajectory.read(file)) == 2 and names(tmp_path) == ["track.tum"]


def test_an_export_that_does_not_fit_on_the_disk_leaves_the_one_of_before(tmp_path):
    file = tmp_path / "track.csv"
    file.write_text("of yesterday\n")
    target = SimpleNamespace(columns=("east_m", "north_m"), heights=SimpleNamespace(column="height_m"))
    track = SimpleNamespace(
        target=target,
        stamps_ns=np.arange(100),
        coordinates=np.zeros((100, 3)),
        roll_pitch_heading_deg=np.zeros((100, 3)),
    )
    with full_disk(1000), pytest.raises(ConfigError, match=r"track\.csv: cannot be written"):
        write_csv(track, file)
    assert file.read_text() == "of yesterday\n"
