"""What a batch is to do is known, and wrong orders are refused, before anything runs."""

import os
from pathlib import Path

import pytest

from holdfast.config.load import parse_config
from holdfast.errors import ConfigError, RecordingError
from holdfast.fleet.plan import Variation, plan
from holdfast.fleet.table import write_table

CONFIG = "# comment\nsensors:\n  imu: {topic: /imu}\ngraph: {lag_s: 2.0}\n"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    (tmp_path / "config.yaml").write_text(CONFIG, encoding="utf-8")
    for name in ("one.bag", "two.bag"):
        (tmp_path / name).write_bytes(name.encode())
    return tmp_path


def jobs(tree: Path, *vary: str, names: tuple[str, ...] = ("one.bag", "two.bag"), options: tuple[str, ...] = ()):
    recordings = [tree / name for name in names]
    return plan(recordings, tree / "config.yaml", [Variation.parse(v) for v in vary], tree / "out", options)


def test_without_variations_there_is_a_job_per_recording(tree: Path):
    assert [job.name for job in jobs(tree)] == ["one", "two"]
    assert [job.folder for job in jobs(tree)] == [tree / "out" / "one", tree / "out" / "two"]


def test_variations_multiply_and_each_job_has_its_configuration(tree: Path):
    found = jobs(tree, "graph.lag_s=1.5,3", "gate.drift_monitor=true,false", names=("one.bag",))
    assert [job.name for job in found] == [
        f"one@graph.lag_s={lag}@gate.drift_monitor={monitor}" for lag in ("1.5", "3") for monitor in ("true", "false")
    ]
    configs = [parse_config(job.config_yaml) for job in found]
    assert [(config.graph.lag_s, config.gate.drift_monitor) for config in configs] == [
        (1.5, True), (1.5, False), (3.0, True), (3.0, False),
    ]  # fmt: skip


def test_null_takes_a_section_away_and_a_preset_fills_in_its_own(tree: Path):
    (tree / "config.yaml").write_text(CONFIG + "standstill: {enabled: true}\n", encoding="utf-8")
    configs = [parse_config(job.config_yaml) for job in jobs(tree, "preset=holdfast,paper", names=("one.bag",))]
    assert [config.graph.nodes for config in configs] == ["measurement", "imu"]
    assert [config.graph.lag_s for config in configs] == [2.0, 2.0]  # what the file itself gives wins


def test_a_key_that_is_varied_twice_is_refused(tree: Path):
    """The last one won, in a folder that named both."""
    with pytest.raises(ConfigError, match=r"--vary graph\.lag_s: is given twice"):
        jobs(tree, "graph.lag_s=3", "gate.drift_monitor=true", "graph.lag_s=2")


@pytest.mark.parametrize("text", ["graph.lag_s", "=3", "graph.lag_s=", "graph.lag_s=1,,2", "graph..lag_s=1"])
def test_a_variation_of_another_form_is_refused_with_an_example(text: str):
    with pytest.raises(ConfigError, match=r"such as graph.lag_s=1.5,3,6"):
        Variation.parse(text)


@pytest.mark.parametrize(
    ("vary", "words"),
    [
        ("graph.lag_s=-1", "graph.lag_s"),
        ("graph.lagg_s=1", "lagg_s"),
        ("graph.lag_s.x=1", "lag_s is no section"),
        ("graph.lag_s='1", "no YAML value"),
    ],
)
def test_a_value_that_is_not_allowed_is_refused_before_anything_runs(tree: Path, vary: str, words: str):
    with pytest.raises(ConfigError, match=words):
        jobs(tree, vary)
    assert not (tree / "out").exists()


def test_recordings_of_one_name_are_distinguished_by_their_folders(tree: Path):
    for folder in ("a", "b"):
        (tree / folder).mkdir()
        (tree / folder / "one.bag").write_bytes(b"x")
    assert [job.name for job in jobs(tree, names=("a/one.bag", "b/one.bag"))] == ["a-one", "b-one"]
    with pytest.raises(ConfigError, match="given twice"):
        jobs(tree, names=("one.bag", "one.bag"))


def test_a_recording_that_is_not_there_is_refused_by_name(tree: Path):
    with pytest.raises(RecordingError, match=r"three\.bag: no such file"):
        jobs(tree, names=("one.bag", "three.bag"))


def test_the_fingerprint_changes_with_everything_that_the_results_depend_on(tree: Path):
    def fingerprints(*vary: str, options: tuple[str, ...] = ()) -> set[str]:
        return {job.fingerprint for job in jobs(tree, *vary, options=options)}

    before = fingerprints()
    assert fingerprints() == before
    assert not fingerprints("graph.lag_s=2.5") & before
    assert not fingerprints(options=("--duration", "5")) & before
    os.utime(tree / "one.bag", ns=(1, 1))
    assert len(fingerprints() & before) == 1  # only one of the two recordings has changed


def test_the_table_takes_a_recording_whose_name_is_no_utf8(tmp_path):
    """All runs were done, and their table was lost to a traceback."""
    file = write_table([{"run": "gr\udcf6sse", "state": "done"}], tmp_path)
    assert file.read_text(encoding="utf-8").splitlines() == ["run,state", r"gr\udcf6sse,done"]
