"""A table of covariances that cannot be read gets one line in words."""

import pytest

from holdfast.errors import RecordingError
from holdfast.recording.covariance_csv import read_covariances


def test_a_file_that_cannot_be_opened_is_told_without_numbers_of_errors(tmp_path):
    """It was `t.csv: [errno 21] is a directory: 't.csv'`."""
    file = tmp_path / "t.csv"
    file.mkdir()
    with pytest.raises(RecordingError, match=r"t\.csv: is a directory$"):
        read_covariances(file)


def test_bytes_that_are_no_text_are_told(tmp_path):
    """It was what the decoder said, in which position and of which byte."""
    file = tmp_path / "t.csv"
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(RecordingError, match=r"t\.csv: is not UTF-8 text$"):
        read_covariances(file)
