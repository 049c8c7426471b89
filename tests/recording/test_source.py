"""Choosing the reader by what lies at the path."""

from pathlib import Path

import pytest

from holdfast.errors import RecordingError
from holdfast.recording.source import open_recording


def test_a_path_where_nothing_is_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere\.bag: no such file or folder"):
        open_recording(tmp_path / "nowhere.bag")


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3"])
def test_an_empty_file_is_an_error(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with pytest.raises(RecordingError, match=f"{name}: the file is empty"):
        open_recording(tmp_path / name)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3"])
@pytest.mark.parametrize("content", [b"x", b"not a recording at all" * 100], ids=["one byte", "text"])
def test_rubbish_is_an_error_of_one_line(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        open_recording(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert "\n" not in str(caught.value)


def test_another_kind_of_file_is_an_error_that_says_what_is_allowed(tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").write_bytes(b"x")
    with pytest.raises(
        RecordingError, match=r"photo\.jpg: is not a recording \(allowed: \.bag, \.mcap, \.db3, or a folder\)"
    ):
        open_recording(tmp_path / "photo.jpg")


def test_a_folder_without_a_recording_is_an_error_that_says_what_is_there(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"holds no recording \(found: nothing; allowed: metadata\.yaml"):
        open_recording(tmp_path)
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "empty.mcap").touch()
    with pytest.raises(RecordingError, match=r"found: empty\.mcap, notes\.txt"):
        open_recording(tmp_path)


def test_metadata_that_names_a_missing_file_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  relative_file_paths: [gone.mcap]\n")
    with pytest.raises(RecordingError, match=r"names files that are missing: gone\.mcap"):
        open_recording(tmp_path)


def test_metadata_that_is_damaged_with_nothing_beside_it_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("[")
    with pytest.raises(RecordingError, match=r"metadata\.yaml: is damaged"):
        open_recording(tmp_path)
