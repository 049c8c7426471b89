"""Files of version 0.1 load as before, and their text can be rewritten without touching anything else."""

import warnings

import pytest

from holdfast.config.load import config_of, parse_config
from holdfast.config.upgrade import upgraded
from holdfast.errors import ConfigError

OLD = """\
sensors:
  imu: {topic: /imu}
  gnss: {topic: /g}
  gnss_right: {topic: /r, frame: right}
  lidar: {topic: /l}
  heading: {topic: /h}
extrinsics: [{parent: imu, child: gnss}, {parent: imu, child: right}, {parent: imu, child: lidar}]
gate: {witness: false}
"""
NEW = """\
sensors:
  imu: {kind: imu, topic: /imu}
  gnss: {kind: gnss, topic: /g}
  gnss_right: {kind: gnss, topic: /r, frame: right}
  lidar: {kind: odometry, topic: /l}
  heading: {kind: heading, topic: /h}
extrinsics: [{parent: imu, child: gnss}, {parent: imu, child: right}, {parent: imu, child: lidar}]
gate: {drift_monitor: false}
"""


def test_an_old_file_loads_as_the_new_one_with_a_warning_that_names_the_remedy() -> None:
    with pytest.warns(UserWarning, match=r"^f\.yaml: is of the old form .*`holdfast config upgrade f\.yaml`"):
        old = parse_config(OLD, "f.yaml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert old == parse_config(NEW, "f.yaml")
    assert list(old.sensors) == ["imu", "gnss", "gnss_right", "lidar", "heading"]


def test_old_data_make_the_same_configuration_without_a_file() -> None:
    data = {"sensors": {"imu": {"topic": "/imu"}, "gnss": None}, "gate": {"witness": False}}
    config = config_of(data, "data")
    assert list(config.sensors) == ["imu"]
    assert not config.gate.drift_monitor
    assert data["sensors"] == {"imu": {"topic": "/imu"}, "gnss": None}  # what was given is left alone


@pytest.mark.filterwarnings("ignore:f.yaml")
def test_only_what_must_change_is_changed() -> None:
    text, changes = upgraded(OLD, "f.yaml")
    assert text == NEW
    assert len(changes) == 6
    assert upgraded(NEW, "f.yaml") == (NEW, [])


def test_comments_quotes_and_units_of_an_old_file_stay() -> None:
    odd = """\
%YAML 1.2
---
"sensors" :      # what it has
    imu:         # taped to the roof

        # the topic
        "topic": '/imu'
        gyroscope_noise_density: {value: 1e-1,   unit: deg/sqrt(h)}
    heading: ~   # not yet
"""
    text, _ = upgraded(odd, "f.yaml")
    assert text == odd.replace('        "topic"', '        kind: imu\n        "topic"').replace(
        "    heading: ~   # not yet\n", ""
    )


def test_a_file_without_a_last_line_end_is_upgraded() -> None:
    text, _ = upgraded("sensors:\n  imu: {topic: /imu}\n  gnss:", "f.yaml")
    assert text == "sensors:\n  imu: {kind: imu, topic: /imu}\n"


def test_a_layout_that_text_cannot_mend_is_refused_with_what_must_change() -> None:
    shared = "sensors:\n  imu: {topic: /imu, frame: imu}\n  gnss: &antenna {topic: /g, frame: imu}\n  lidar: *antenna\n"
    with pytest.raises(ConfigError, match=r"f\.yaml: must be rewritten by hand \(sensors\.imu: now `kind: imu`; "):
        upgraded(shared, "f.yaml")


def test_mistakes_of_an_old_file_keep_their_lines() -> None:
    with pytest.raises(ConfigError, match=r"f\.yaml:8 gate\.witnes: unknown key"):
        upgraded(OLD.replace("witness", "witnes"), "f.yaml")
