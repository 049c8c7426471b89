"""What the documentation site has beside the pages in docs/: the README, the glossary, the API, the list of decisions.

They are made when the site is built, so nothing is written twice. Formulas become MathML, so the site needs no script
and no network for them. Links to files of the repository, which the site has not, become the names of the files.
"""

import html
import os
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

import holdfast

DOCS = Path(__file__).parent.parent
ROOT = DOCS.parent
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]+)\)")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
SHIM = "https://unpkg.com/iframe-worker/shim"
TAG = re.compile(r"\\tag\{(\d+)\}")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are made."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8").replace("](docs/", "](").replace("/](decisions/)", "")
    readme = re.sub(r"\]\(decisions/\)", "](decisions/index.md)", readme)
    pages = {"index.md": readme, "glossary.md": _glossary(), "api.md": _api(), "decisions/index.md": _decisions()}
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Name the files that are not on the site instead of linking them."""
    folder = Path(page.file.src_uri).parent

    def named(match: re.Match[str]) -> str:
        mark, text, target = match.groups()
        path = target.partition("#")[0]
        if not path or "://" in path or target.startswith("mailto:"):
            return match.group()
        where = os.path.normpath(folder / path)
        if page.file.src_uri == "index.md" and not (DOCS / where).exists() and (ROOT / path).exists():
            return text if text in path else f"{text} (`{path}`)"
        if where == "decisions" or (DOCS / where).is_dir():
            return f"{mark}[{text}]({os.path.relpath('decisions/index.md', folder)})"
        if where.startswith(".."):
            name = os.path.relpath((DOCS / where).resolve(), ROOT)
            return f"`{name}`" if text.strip("`") in name else f"{text} (`{name}`)"
        return match.group()

    parts = re.split(r"(^```.*?^```$)", markdown, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if part.startswith("```") else LINK.sub(named, part) for part in parts)


def on_page_content(content: str, **_: Any) -> str:
    """Write formulas as MathML."""

    def formula(match: re.Match[str]) -> str:
        is_block = match.group(1) == "div"
        latex = html.unescape(match.group(2))
        number = TAG.search(latex)
        mathml = convert(TAG.sub("", latex).strip(), display="block" if is_block else "inline")
        if number is None:
            return mathml
        return f'<div class="equation" id="eq-{number[1]}">{mathml}<span>({number[1]})</span></div>'

    return FORMULA.sub(formula, content)


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Take the worker for pages on a disk from the site, not from the network."""
    return output.replace(SHIM, f"{'../' * page.url.count('/')}_site/worker.js")


def on_post_template(output_content: str, **_: Any) -> str:
    """Do the same for the page of what is not found."""
    return output_content.replace(SHIM, "_site/worker.js")


def _glossary() -> str:
    text = (DOCS / "conventions.md").read_text(encoding="utf-8")
    return "# Glossary\n" + text.partition("\n## Glossary\n")[2]


def _api() -> str:
    modules = holdfast._PUBLIC
    names = sorted(name for name in holdfast.__all__ if name in modules)
    parts = ["# API\n\nThe public names of `holdfast`: `from holdfast import ...`.\n"]
    parts += [f"::: holdfast.{modules[name]}.{name}\n" for name in names]
    return "\n".join(parts)


def _decisions() -> str:
    records = sorted((DOCS / "decisions").glob("[0-9]*.md"))
    titles = [(record.name, record.read_text(encoding="utf-8").splitlines()[0].lstrip("# ")) for record in records]
    return "# Decisions\n\n" + "\n".join(f"- [{title}]({name})" for name, title in titles) + "\n"
