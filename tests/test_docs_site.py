"""The documentation site: built without a warning, complete, and readable without a network."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import holdfast
from holdfast.config.kinds import KINDS
from holdfast.config.load import load_config
from holdfast.recording.kinds import KINDS as RECORDED

sys.path.append(str(Path(__file__).parent / "report"))

from chromium import DESKTOP, Page, needs_chromium

ROOT = Path(__file__).parent.parent
SENSORS = ROOT / "docs" / "sensors"
LOADED = re.compile(r'<(?:script|img|iframe|source)[^>]* src="([^"]+)"|<link[^>]* href="([^"]+)"')
BUILT_IN = set(KINDS) - {"radar"}  # a test registers that one


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs", reason="mkdocs is not installed (extra `dev`)")
    folder = tmp_path_factory.mktemp("site")
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr  # with --quiet mkdocs does not count them, whatever --strict asks for
    return folder


def test_the_site_has_every_page_of_the_docs(site: Path):
    pages = [page.relative_to(ROOT / "docs").with_suffix(".html") for page in ROOT.glob("docs/**/*.md")]
    assert len(pages) > 40
    assert not [page for page in pages if not (site / page).is_file()]
    for made in ("index.html", "glossary.html", "api.html", "decisions/index.html"):
        assert (site / made).is_file()


def test_nothing_on_the_site_is_loaded_from_elsewhere(site: Path):
    pages = list(site.rglob("*.html"))
    loaded = {a or b for page in pages for a, b in LOADED.findall(page.read_text(encoding="utf-8"))}
    assert len(loaded) > 5
    assert not [target for target in loaded if "//" in target.removeprefix("data:")]
    styles = [style.read_text(encoding="utf-8") for style in site.rglob("*.css")]
    assert not [found for style in styles for found in re.findall(r"url\(\s*[\"']?(?:https?:)?//", style)]


def test_every_public_name_is_in_the_api(site: Path):
    text = (site / "api.html").read_text(encoding="utf-8")
    names = [name for name in holdfast.__all__ if name != "__version__"]
    assert len(names) >= 20
    assert not [name for name in names if not re.search(rf'id="holdfast\.[a-z_.]+\.{name}"', text)]


def test_formulas_need_no_script(site: Path):
    text = (site / "math.html").read_text(encoding="utf-8")
    tags = re.findall(r"\\tag\{(\d+)\}", (ROOT / "docs/math.md").read_text(encoding="utf-8"))
    assert [number for number in tags if f'id="eq-{number}"' not in text] == []
    assert text.count("<math") > 3 * len(tags)
    prose = re.sub(r"<pre>.*?</pre>|<code>.*?</code>", "", text, flags=re.DOTALL)
    assert not re.search(r"\\(?:frac|mathrm|text|Sigma|tag)\b", prose)


@needs_chromium
def test_the_site_is_read_and_searched_from_a_disk_without_a_network(site: Path, tmp_path: Path):
    with Page(site / "index.html", tmp_path, DESKTOP) as opened:
        opened.value_of(
            "(() => { const field = document.querySelector('.md-search__input'); field.focus();"
            " field.value = 'lever arm'; for (const kind of ['input', 'keyup'])"
            " field.dispatchEvent(new Event(kind, { bubbles: true })); })()"
        )
        opened._wait_for("document.querySelectorAll('.md-search-result__item').length > 3")
        assert opened.requests == {}
        assert opened.errors == []


def test_every_kind_of_sensor_has_a_how_to():
    assert {page.stem for page in SENSORS.glob("*.md")} == BUILT_IN


@pytest.mark.parametrize("kind", sorted(BUILT_IN))
def test_the_how_to_of_a_sensor_shows_a_configuration_that_loads_and_its_messages(kind: str, tmp_path: Path):
    text = (SENSORS / f"{kind}.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^```yaml\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    (tmp_path / "machine.yaml").write_text(shown)
    config = load_config(tmp_path / "machine.yaml")
    assert kind in {sensor.kind for sensor in config.sensors.values()}
    (row,) = re.findall(r"^\| Message \| (.*) \|$", text, re.MULTILINE)
    messages = {name.replace("/msg/", "/") for name in RECORDED[kind].decoders} if kind in RECORDED else set()
    assert set(re.findall(r"`([a-z_]+/\w+)`", row)) == messages
