"""A report as one HTML file that needs no network: text, tables and figures; and the same numbers as JSON.

Everything is in the file: plotly's script once, the style, the data. A content security policy forbids whatever would
leave it. Figures are plotly figures (`holdfast.report.figures`); tables hold the numbers.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from html import escape
from importlib.resources import files
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.whole_file import write_whole

if TYPE_CHECKING:
    from plotly.graph_objects import Figure as Plot

Cell = str | float | int | None
Mark = Literal["best", "reached", "missed"]

POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
MISSING = "–"
NUMBER = re.compile(r"[-–]|-?(\d[\d.e+-]*|inf|never)( ± [\d.e+-]+)?")


@dataclass(frozen=True, slots=True)
class Provenance:
    """How the numbers were made; stands once on a page, and beside what was made otherwise.

    Attributes:
        command: that makes them again.
        versions: of the packages, by name.
        config_digest: `digest` of the resolved configuration; empty where none was used.
        seed: in words where there are several; empty where nothing is random.
    """

    command: str
    versions: Mapping[str, str]
    config_digest: str = ""
    seed: str = ""

    def line(self) -> str:
        """Return it in one line."""
        parts = [self.command, f"seed {self.seed}" * bool(self.seed), f"config {self.config_digest}"]
        parts[2] *= bool(self.config_digest)
        parts.append(", ".join(f"{name} {version}" for name, version in self.versions.items()))
        return " · ".join(part for part in parts if part)


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph; a note stands out."""

    text: str
    note: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """Numbers in rows.

    Attributes:
        key: its name in the JSON, unique in the page.
        columns: headings, with units.
        rows: of as many cells as there are columns; None is shown as a dash.
        digits: significant digits of numbers that are not whole.
        marks: (row, column) -> how a cell stands out.
        provenance: None for the page's own.
        times_s: of the rows, where each is something that happened; a click on it moves the plots there.
    """

    key: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    digits: int = 3
    marks: Mapping[tuple[int, int], Mark] = field(default_factory=dict)
    provenance: Provenance | None = None
    times_s: Sequence[float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """A plotly figure with its caption; attributes as those of `Table`."""

    key: str
    title: str
    plot: "Plot"
    caption: str = ""
    provenance: Provenance | None = None


@dataclass(frozen=True, slots=True)
class Row:
    """Figures side by side, as many as there is room for."""

    figures: Sequence[Figure]


Block = Text | Table | Figure | Row


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what stands below it."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class Clock:
    """The time of a page about one run: all its plots over time then show the same stretch.

    Attributes:
        start_s: since 1970, from which times count.
        end_s: last time that is shown first.
    """

    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Page:
    """A whole report.

    Attributes:
        lead: what a reader should know who reads nothing else.
        provenance: of everything that does not bring its own.
        clock: None where plots over time have nothing to do with each other.
    """

    title: str
    lead: str
    provenance: Provenance
    sections: Sequence[Section]
    clock: Clock | None = None


def digest(config: Mapping[str, Any]) -> str:
    """Return the first 12 digits of the SHA-256 of a resolved configuration, as sorted JSON."""
    return sha256(json.dumps(config, sort_keys=True).encode()).hexdigest()[:12]


def page_file(path: str | PathLike[str], option: str = "") -> Path:
    """Return the file of a page; `option` names where the user gave it.

    Raises:
        ConfigError: the name does not end in .html.
    """
    file = Path(path)
    if file.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"{option}{file}: the name must end in .html")
    return file


def write_page(page: Page, path: Path) -> None:
    """Write the page, and beside it its numbers with the suffix .json; each whole or not at all.

    Raises:
        ConfigError: plotly is not installed, a key is not unique, or a file cannot be written.
    """
    html, numbers = render(page), json.dumps(numbers_of(page), indent=1, allow_nan=False)
    for file, text in ((path, html), (path.with_suffix(".json"), numbers + "\n")):
        write_whole(file, text)


def render(page: Page) -> str:
    """Return the page as HTML.

    Raises:
        ConfigError: plotly is not installed, or a key is not unique.
    """
    _check_keys(page)
    room = files("holdfast.report")
    style, script = (room.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    clock = page.clock
    times = "" if clock is None else f' data-start="{clock.start_s:.6f}" data-end="{clock.end_s:.6f}"'
    whole = "" if clock is None else '<button type="button" id="all">show all</button>'
    links = "".join(f'<a href="#s{k}">{escape(section.title)}</a>' for k, section in enumerate(page.sections))
    body = "".join(_section(k, section) for k, section in enumerate(page.sections))
    return (
        "<!DOCTYPE html>\n"
        f'<html lang="en"{times}>\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(page.title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        f"<h1>{escape(page.title)}</h1>\n<p>{escape(page.lead)}</p>\n"
        f'<p class="provenance">{escape(page.provenance.line())}</p>\n'
        f'<nav aria-label="Contents">{links}{whole}</nav>\n<main>\n'
        "<noscript><p class=note>The figures need JavaScript; the tables do not.</p></noscript>\n"
        f"{body}\n</main>\n<script>{_plotly_script()}</script>\n<script>\n{script}</script>\n</body>\n</html>\n"
    )


def numbers_of(page: Page) -> dict[str, Any]:
    """Return what the page shows as numbers: every table, and the points of every figure."""
    blocks = _keyed(page)
    return {
        "title": page.title,
        "lead": page.lead,
        "provenance": _provenance(page.provenance),
        "tables": {table.key: _table_numbers(table) for table in blocks if isinstance(table, Table)},
        "figures": {figure.key: _figure_numbers(figure) for figure in blocks if isinstance(figure, Figure)},
    }


def shown(value: Cell, digits: int = 3) -> str:
    """Return a cell as text: whole numbers in full, others with so many significant digits."""
    if value is None or (isinstance(value, float) and not isfinite(value)):
        return MISSING
    if isinstance(value, str | int):
        return str(value)
    if value == 0.0 or abs(value) >= 10 ** (digits - 1):
        return f"{value:.0f}"
    text = f"{value:#.{digits}g}"
    return text if "e" in text else text.removesuffix(".")


def _section(index: int, section: Section) -> str:
    blocks = "\n".join(_block(block) for block in section.blocks)
    return f'<section>\n<h2 id="s{index}">{escape(section.title)}</h2>\n{blocks}\n</section>\n'


def _block(block: Block) -> str:
    if isinstance(block, Text):
        return f"<p{' class=note' if block.note else ''}>{escape(block.text)}</p>"
    if isinstance(block, Row):
        return f'<div class="row">{"".join(_block(figure) for figure in block.figures)}</div>'
    inner = _table(block) if isinstance(block, Table) else _plot(block)
    caption = f"<figcaption>{escape(block.caption)}</figcaption>" if block.caption else ""
    made = "" if block.provenance is None else f'<div class="provenance">{escape(block.provenance.line())}</div>\n'
    return f'<figure id="{escape(block.key)}">\n<h3>{escape(block.title)}</h3>\n{inner}\n{caption}\n{made}</figure>'


def _table(table: Table) -> str:
    numeric = [all(_is_number(row[k]) for row in table.rows) for k in range(len(table.columns))]
    head = "".join(
        f"<th{' class=number' if is_number else ''}>{escape(text)}</th>"
        for text, is_number in zip(table.columns, numeric, strict=True)
    )
    rows = []
    for i, row in enumerate(table.rows):
        cells = []
        for k, (value, is_number) in enumerate(zip(row, numeric, strict=True)):
            style = " ".join(filter(None, ["number" * is_number, table.marks.get((i, k), "")]))
            cells.append(f'<td class="{style}">{escape(shown(value, table.digits))}</td>')
        time = (
            ""
            if table.times_s is None
            else f' data-time="{table.times_s[i]:.6f}" tabindex="0" title="show this time in every plot"'
        )
        rows.append(f"<tr{time}>{''.join(cells)}</tr>")
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>\n'
        + "\n".join(rows)
        + "\n</tbody></table></div>"
    )


def _is_number(value: Cell) -> bool:
    """Whether a cell stands to the right: a number, also one that is text, such as `1.2 ± 0.3`."""
    return not isinstance(value, str) or bool(NUMBER.fullmatch(value))


def _plot(figure: Figure) -> str:
    height = figure.plot.layout.height or 450
    data = figure.plot.to_json().replace("</", "<\\/")
    return (
        f'<div class="plot" data-figure="{escape(figure.key)}-data" style="min-height: {height:.0f}px"></div>\n'
        f'<script type="application/json" id="{escape(figure.key)}-data">{data}</script>'
    )


def _check_keys(page: Page) -> None:
    keys = [block.key for block in _keyed(page)]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        raise ConfigError(f"report: {', '.join(twice)} names more than one figure or table")


def _keyed(page: Page) -> list[Table | Figure]:
    """Return all tables and figures of a page."""
    blocks = [block for section in page.sections for block in section.blocks]
    flat = [figure for block in blocks for figure in (block.figures if isinstance(block, Row) else [block])]
    return [block for block in flat if isinstance(block, Table | Figure)]


def _plotly_script() -> str:
    with needing("a report", "report"):
        from plotly.offline import get_plotlyjs
    script: str = get_plotlyjs()
    return script.replace("</script", "<\\/script")


def _provenance(provenance: Provenance) -> dict[str, Any]:
    return {
        "command": provenance.command,
        "versions": dict(provenance.versions),
        "config_digest": provenance.config_digest,
        "seed": provenance.seed,
    }


def _table_numbers(table: Table) -> dict[str, Any]:
    made = None if table.provenance is None else _provenance(table.provenance)
    rows = [[_finite(value) for value in row] for row in table.rows]
    return {"title": table.title, "columns": list(table.columns), "rows": rows, "provenance": made}


def _figure_numbers(figure: Figure) -> dict[str, Any]:
    made = None if figure.provenance is None else _provenance(figure.provenance)
    traces = [
        {"name": trace.name} | {axis: [_finite(value) for value in _list(trace[axis])] for axis in ("x", "y")}
        for trace in figure.plot.data
    ]
    return {"title": figure.title, "caption": figure.caption, "traces": traces, "provenance": made}


def _list(values: Any) -> list[Any]:
    return [] if values is None else values.tolist() if hasattr(values, "tolist") else list(values)


def _finite(value: Any) -> Any:
    """Return a number with the digits that a figure can show; JSON knows no NaN and no infinity."""
    if not isinstance(value, float):
        return value
    return float(f"{value:.9g}") if isfinite(value) else None
