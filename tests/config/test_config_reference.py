"""The committed reference is the model, and the JSON schema accepts what the loader accepts."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from holdfast.config.extrinsics import Extrinsic
from holdfast.config.kinds import KINDS
from holdfast.config.load import parse_config
from holdfast.config.model import Config
from holdfast.config.reference import COMMAND, editor_schema, reference_tables, with_tables
from holdfast.config.schema import ROOT
from holdfast.config.sensors import RobustLoss

PAGE = Path(__file__).parents[2] / "docs" / "configuration.md"


def test_the_committed_reference_is_up_to_date() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert with_tables(page) == page, f"docs/configuration.md is stale: run `{COMMAND}` and commit the page"


def test_the_command_named_in_a_failure_writes_the_page_anew(tmp_path: Path) -> None:
    stale = tmp_path / "page.md"
    page = PAGE.read_text(encoding="utf-8")
    stale.write_text(re.sub(r"\| `topic`.*\n", "", page), encoding="utf-8")
    python, *arguments = COMMAND.split()
    assert python == "python"
    subprocess.run([sys.executable, *arguments[:-1], str(stale)], check=True)
    assert stale.read_text(encoding="utf-8") == with_tables(page)


def test_a_page_without_the_markers_is_refused() -> None:
    with pytest.raises(ValueError, match="must hold the lines"):
        with_tables("# Configuration\n")


def test_every_key_of_every_section_has_a_row_with_as_many_cells_as_the_head() -> None:
    tables = reference_tables()
    for section in (Config, RobustLoss, Extrinsic, *KINDS.values()):
        for name in section.model_fields:
            assert f"\n| `{name}` |" in tables
    rows = [line for line in tables.splitlines() if line.startswith("|")]
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {7}


def test_every_kind_of_sensor_has_a_heading_of_its_own() -> None:
    headings = [line for line in reference_tables().splitlines() if line.startswith("### `sensors.")]
    assert [f"### `sensors.<{kind}>`" for kind in KINDS] == [h for h in headings if "robust_loss" not in h]


def test_the_example_on_the_page_loads_and_its_faults_are_those_of_the_loader() -> None:
    page = PAGE.read_text(encoding="utf-8")
    example = re.search(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert example is not None
    assert parse_config(example[1]).sensors.keys() == {"imu", "gnss"}


def test_the_schema_names_units_and_allows_quantities_and_bare_headings() -> None:
    schema = editor_schema()
    imu = schema["$defs"]["ImuConfig"]["properties"]["gyroscope_noise_density"]
    assert imu["description"].endswith("[rad/s/sqrt(Hz)]")
    number, quantity = imu["anyOf"]
    assert number == {"type": "number", "exclusiveMinimum": 0, "maximum": 1}
    assert "deg/sqrt(h)" in quantity["properties"]["unit"]["examples"]
    assert {"type": "null"} in schema["properties"]["graph"]["anyOf"]
    assert set(schema["properties"]) == {name for name, _ in ROOT.children()}
