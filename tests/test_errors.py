"""The text of an error can be printed, whatever the input was called."""

import pytest

from holdfast.config.load import parse_config
from holdfast.errors import ConfigError, RecordingError


def test_an_error_is_printable_whatever_it_quotes_and_keeps_its_lines():
    error = RecordingError("a\x1b[2J.mcap: is cut\n\ufefftopic\udcff: none")
    assert str(error) == "a\\x1b[2J.mcap: is cut\n\\ufefftopic\\udcff: none"


@pytest.mark.parametrize("unit", ["de\ufeffg/s", "deg\nconfig:1 fine", "d" * 5000])
def test_a_unit_that_holds_what_cannot_be_printed_is_escaped_and_cut(unit: str):
    quoted = unit.replace("\n", "\\n")
    text = f'sensors: {{imu: {{kind: imu, topic: /imu, gyroscope_bias_sigma: {{value: "x", unit: "{quoted}"}}}}}}'
    with pytest.raises(ConfigError, match="must be a number") as caught:
        parse_config(text)
    lines = str(caught.value).split("\n")
    assert all(line.isprintable() and len(line) < 1000 for line in lines)
    assert not any(line.startswith("config:1 fine") for line in lines)
