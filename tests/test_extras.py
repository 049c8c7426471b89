"""What is said where a package is missing: one command, made in one place, that works from a checkout."""

import re
import tomllib
from pathlib import Path

import pytest

from holdfast.errors import ConfigError
from holdfast.extras import how_to_install, needing

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))


def test_a_missing_package_is_named_with_a_command_that_works_from_a_checkout_and_in_zsh():
    with pytest.raises(ConfigError) as raised, needing("a report", "report"):
        raise ModuleNotFoundError("No module", name="plotly.offline")
    assert str(raised.value) == "a report needs plotly: pip install -e '.[report]' in the checkout of Holdfast"


def test_no_other_file_tells_how_to_install_an_extra_and_none_names_a_package_index():
    telling = [path.name for path in SOURCES if re.search(r"pip install[^\n]*\[", path.read_text())]
    assert telling == ["extras.py"]
    pages = [*SOURCES, *(ROOT / "docs").rglob("*.md")]
    assert [path.name for path in pages if re.search(r"pip install ['\"]?holdfast", path.read_text())] == []


def test_every_extra_that_is_named_exists():
    known = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    texts = "\n".join(path.read_text() for path in SOURCES)
    named = re.findall(r'needing\([^)]*, "(\w+)"\)|how_to_install\(["\']([\w,]+)["\']\)', texts)
    assert len(named) > 10
    assert {extra for one, many in named for extra in (one or many).split(",")} <= known
    assert all(f".[{extra}]" in how_to_install(extra) for extra in known)
