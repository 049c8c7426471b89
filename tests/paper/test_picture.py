"""The picture of the README: every system through both outages, light enough for a page."""

import numpy as np
import pytest
from test_paper_page import results

from holdfast.errors import ConfigError
from holdfast.paper.picture import draw_picture, rms_in_bins
from holdfast.paper.results import Results


def test_the_rms_of_bins_is_that_of_their_values_and_empty_bins_are_left_out():
    times_s = np.concatenate([np.linspace(0.0, 10.0, 1001), np.linspace(30.0, 40.0, 1001)])
    values = np.where(times_s < 15.0, 3.0, -4.0)
    at_s, rms = rms_in_bins(times_s, values, 8)  # of 5 s each; two of them lie in the gap
    assert at_s.tolist() == pytest.approx([2.5, 7.5, 12.5, 32.5, 37.5])
    assert rms.tolist() == pytest.approx([3.0, 3.0, 3.0, 4.0, 4.0])
    _, mixed = rms_in_bins(np.arange(2000.0), np.tile([3.0, 4.0], 1000), 1)
    assert mixed.tolist() == pytest.approx([np.sqrt(12.5)])


def test_the_picture_has_a_white_ground_for_pages_of_any_colour_and_is_light(tmp_path):
    from matplotlib.image import imread

    file = draw_picture(results(), tmp_path)
    assert file.stat().st_size < 200_000
    pixels = imread(file)
    assert pixels.shape[1] >= 1000
    np.testing.assert_array_equal(pixels[[0, 0, -1, -1], [0, -1, 0, -1], :3], 1.0)
    if pixels.shape[2] == 4:
        assert pixels[..., 3].min() == 1.0  # nothing shines through


def test_the_same_results_give_the_same_picture(tmp_path):
    once = draw_picture(results(), tmp_path).read_bytes()
    assert draw_picture(results(), tmp_path).read_bytes() == once


def test_a_picture_of_nothing_and_a_folder_where_it_cannot_be_written_are_refused(tmp_path):
    from dataclasses import replace

    empty: Results = replace(results(), curves={})
    with pytest.raises(ConfigError, match=r"outage\.png: no system has a verdict"):
        draw_picture(empty, tmp_path)
    with pytest.raises(ConfigError, match="cannot be written"):
        draw_picture(results(), tmp_path / "nowhere")
