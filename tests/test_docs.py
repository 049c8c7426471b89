"""The docs say what is true: links, equation numbers, commands, pins; nothing in the repository names a machine."""

import os
import re
import shlex
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner
from packaging.requirements import Requirement
from ruamel.yaml import YAML

from holdfast.cli import COMMANDS, holdfast

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
MATHS = re.compile(r"\$\$.*?\$\$|\$[^$]*\$", re.DOTALL)
CITATION = re.compile(r"((?:\(\d+\)(?:, | and |-| to )?)+) in (?:docs/math\.md|\[math\.md\])")


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def numbers(citation: str) -> list[int]:
    return [int(number) for number in re.findall(r"\((\d+)\)", citation)]


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_relative_link_resolves(page):
    prose = MATHS.sub("", FENCE.sub("", page.read_text(encoding="utf-8")))
    targets = re.findall(r"\]\(([^)\s]+)\)", prose)
    broken = [
        target
        for target in targets
        if not target.startswith(("https://", "#")) and not (page.parent / target.partition("#")[0]).exists()
    ]
    assert not broken


def test_readme_links_every_page_of_the_docs():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    missing = [name(page) for page in ROOT.glob("docs/*.md") if f"]({name(page)})" not in readme]
    assert not missing


def test_equations_are_numbered_from_one_without_holes():
    tags = re.findall(r"\\tag\{(\d+)\}", (ROOT / "docs/math.md").read_text(encoding="utf-8"))
    assert len(tags) > 20
    assert [int(tag) for tag in tags] == list(range(1, len(tags) + 1))


def test_every_mention_of_the_maths_in_the_source_cites_an_equation_that_exists():
    tags = {int(tag) for tag in re.findall(r"\\tag\{(\d+)\}", (ROOT / "docs/math.md").read_text(encoding="utf-8"))}
    cited: dict[str, list[int]] = {}
    for file in sorted(ROOT.glob("src/**/*.py")):
        text = re.sub(r"\s+", " ", file.read_text(encoding="utf-8"))
        found = [number for citation in CITATION.findall(text) for number in numbers(citation)]
        assert len(CITATION.findall(text)) == text.count("docs/math.md"), f"{name(file)} cites no number"
        if found:
            cited[name(file)] = found
    assert len(cited) >= 5
    assert not {file: set(found) - tags for file, found in cited.items() if set(found) - tags}


def test_every_equation_that_the_docs_cite_exists():
    tags = {int(tag) for tag in re.findall(r"\\tag\{(\d+)\}", (ROOT / "docs/math.md").read_text(encoding="utf-8"))}
    cited = [
        number
        for page in PAGES
        for citation in CITATION.findall(re.sub(r"\s+", " ", page.read_text(encoding="utf-8")))
        for number in numbers(citation)
    ]
    assert len(cited) > 5
    assert set(cited) <= tags


def shown_commands() -> list[tuple[str, str]]:
    """Commands of the form `holdfast ...` in fenced blocks, in code within prose, and in the Makefile."""
    found = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        lines = [line for block in FENCE.findall(text) for line in block.splitlines()]
        lines += [re.sub(r"\s+", " ", code) for code in re.findall(r"`([^`]+)`", FENCE.sub("", text))]
        found += [(name(page), line.strip()) for line in lines if re.match(r"\s*holdfast [a-z-]", line)]
    recipes = re.findall(r"/(holdfast [a-z].*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    return sorted({*found, *(("Makefile", recipe) for recipe in recipes)})


@pytest.mark.parametrize(("page", "line"), shown_commands())
def test_every_command_that_is_shown_parses(page, line):
    words = shlex.split(re.split(r"[>|]", line)[0], comments=True)[1:]
    command: click.Command = holdfast
    path: list[str] = []
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        context = click.Context(command)
        following = command.get_command(context, words[0])
        assert following is not None, f"{page}: holdfast has no command {' '.join([*path, words[0]])!r}"
        command = following
        path.append(words.pop(0))
    if not {"--help", "--version"} & set(words):
        _, left, _ = command.make_parser(click.Context(command)).parse_args(list(words))
        assert not left, f"{page}: {line!r} has arguments that no parameter takes"
    assert CliRunner().invoke(holdfast, [*path, "--help"]).exit_code == 0


def test_readme_shows_how_to_use_an_own_recording():
    shown = {line.split()[1] for page, line in shown_commands() if page == "README.md"}
    assert {"info", "config", "replay", "evaluate"} <= shown <= set(COMMANDS)


def test_every_make_target_that_is_named_exists():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    texts = [page.read_text(encoding="utf-8") for page in [*PAGES, ROOT / ".ci/run"]]
    named = {target for text in texts for target in re.findall(r"(?:^|`)make ([a-z]+)", text, re.MULTILINE)}
    assert {"demo", "test", "check"} <= named <= targets


def test_architecture_names_every_room_and_the_layers_that_are_enforced():
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    rooms = [path.parent.name for path in ROOT.glob("src/holdfast/*/__init__.py")]
    assert len(rooms) > 5
    assert not [room for room in rooms if f"| `{room}/` |" not in page]
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (layers,) = [contract["layers"] for contract in contracts if contract["type"] == "layers"]
    assert "\n".join(f" {layer.replace('holdfast.', '')}" for layer in layers) in page


def test_every_piece_of_the_page_on_new_sensors_stands_in_the_test_that_runs_it():
    page = (ROOT / "docs/new-sensor.md").read_text(encoding="utf-8")
    source, _, _ = (ROOT / "tests/test_new_sensor.py").read_text(encoding="utf-8").partition("\n# --- the test")
    pieces = re.findall(r"^```python\n(.*?)\n```$", page, re.MULTILINE | re.DOTALL)
    assert not [piece for piece in pieces if f"\n{piece}\n" not in source]
    steps = re.findall(r"^# --- \d\. .*$", source, re.MULTILINE)
    assert len(steps) == len(pieces) == len(re.findall(r"^## \d\. ", page, re.MULTILINE)) == 6
    defined = set(re.findall(r"^(?:class|def) (\w+)", source, re.MULTILINE))
    assert defined == {name for piece in pieces for name in re.findall(r"^(?:class|def) (\w+)", piece, re.MULTILINE)}


def test_the_glossary_names_files_and_settings_that_exist():
    text = (ROOT / "docs/conventions.md").read_text(encoding="utf-8")
    glossary = text.partition("\n## Glossary\n")[2].partition("\nWords of version 0.1")[0]
    folders: list[Path] = []
    for row in re.findall(r"^\| [a-z].*$", glossary, re.MULTILINE | re.IGNORECASE)[1:]:
        files = re.findall(r"`([\w/]+(?:\.py|/))`", row.rsplit("|", 2)[1])
        for file in files:  # the second file of a row is in the folder of the first, or names its own
            here = [ROOT / "src/holdfast" / file, *(folder / file for folder in folders[-1:])]
            assert any(path.exists() for path in here), row
            folders += [path.parent for path in here[:1] if path.exists()]
    assert len(folders) > 20


OLD_NAMES = re.compile(
    r"main_lidar|fallback_lidar|antenna_(?:lost|regained)|lidar_(?:jump|slip|lost)|LidarPose|LidarWitness|ScanChain|"
    r"AntennaGate|Chronicle\b|Journal\b"
)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_no_page_uses_a_name_of_version_0_1(page):
    text = page.read_text(encoding="utf-8")
    if page.name in ("CHANGELOG.md", "configuration.md"):
        pytest.skip("names both forms on purpose")
    text = text.partition("\nWords of version 0.1")[0] if page.name == "conventions.md" else text
    assert not OLD_NAMES.findall(text)


def test_every_sensor_that_the_docs_show_has_a_kind():
    blocks = [b for page in PAGES for b in re.findall(r"^```yaml\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)]
    shown = [block for block in map(yaml_data, blocks) if "sensors" in block and "machine" not in block]  # no scenario
    assert len(shown) >= 3
    assert not [sensor for data in shown for sensor in data["sensors"].values() if sensor and "kind" not in sensor]


def yaml_data(text: str) -> dict[str, Any]:
    data = YAML(typ="safe").load(text)
    return data if isinstance(data, dict) else {}


def repository_files() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("not a git checkout")
    return [ROOT / line for line in listed.stdout.decode().split("\0") if line and (ROOT / line).is_file()]


def test_no_file_names_a_package_registry_or_a_path_of_a_machine():
    registry = re.compile(r"(?:pypi|pythonhosted|anaconda)\.(?:org|com)|--(?:extra-)?index-url|--find[-]links")
    machine = re.compile(r"(?<![\w./:-])/(?:root|home|Users|tmp|opt|work|mnt|srv)/\w")
    files = repository_files()
    assert ROOT / "constraints.txt" in files
    named = [
        f"{name(file)}: {found.group()}"
        for file in files
        if b"\0" not in (content := file.read_bytes())
        if (found := registry.search(text := content.decode(errors="replace")) or machine.search(text))
    ]
    assert not named


def test_ci_script_is_executable_and_fails_when_a_step_fails():
    script = ROOT / ".ci/run"
    assert os.access(script, os.X_OK)
    text = script.read_text(encoding="utf-8")
    assert re.search(r"^make .*\blint\b", text, re.MULTILINE)
    assert "make test" in text
    assert "pipefail" in text


def test_changelog_has_an_unreleased_section_with_entries():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    _, _, after = text.partition("\n## [Unreleased]\n")
    assert re.search(r"^- ", after.partition("\n## ")[0], re.MULTILINE)


def test_decisions_are_numbered_from_one_and_have_the_three_parts():
    records = sorted(ROOT.glob("docs/decisions/*.md"))
    assert [int(record.name[:3]) for record in records] == list(range(1, len(records) + 1))
    for record in records:
        text = record.read_text(encoding="utf-8")
        assert text.startswith(f"# {record.name[:3]}: "), name(record)
        assert all(f"**{part}.**" in text for part in ("Context", "Decision", "Consequences")), name(record)


def test_every_direct_dependency_is_pinned_within_its_range():
    pins = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            pin = Requirement(line.partition("#")[0])
            assert [specifier.operator for specifier in pin.specifier] == ["=="], line
            pins[normalised(pin.name)] = next(iter(pin.specifier)).version
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(r for extra in project["optional-dependencies"].values() for r in extra)]
    requirements = [Requirement(text) for text in wanted if not text.startswith("holdfast[")]
    assert len(requirements) > 10
    outside = [str(r) for r in requirements if not r.specifier.contains(pins.get(normalised(r.name), "0"))]
    assert not outside


def normalised(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()
