"""The report of the paper's evaluation: one page that a reviewer can open offline."""

from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

from holdfast.paper import losses, page_figures, page_tables
from holdfast.paper.maps import Maps, load_maps, map_figures, title
from holdfast.paper.results import Results
from holdfast.paper.study import TASKS
from holdfast.paper.tables import OURS, QUANTITIES, failures, lost_cells
from holdfast.report.page import Block, Figure, Page, Provenance, Row, Section, Table, Text, write_page

REPORT = "report.html"


def write_report(results: Results, folder: Path) -> Path:
    """Write OUT/report.html and report.json, and return the path of the page; maps are in it if they were made.

    Raises:
        ConfigError: plotly is not installed, or a file cannot be written.
    """
    file = folder / REPORT
    write_page(paper_page(results, load_maps(folder)), file)
    return file


def paper_page(results: Results, maps: Maps | None = None) -> Page:
    """Return the report."""
    digest = sha256("\n".join(results.scenarios.values()).encode()).hexdigest()[:12]
    seeds = "0" if results.seeds == 1 else f"0 to {results.seeds - 1}"
    provenance = Provenance(results.command, results.versions, digest, seeds)
    sections = [
        Section("Table I: accuracy", list(_accuracy(results))),
        Section("Table II: latency", list(_latency(results))),
        Section("Figs. 3 and 4: through the outages", list(_outages(results))),
        Section("Fig. 6: consistency", list(_consistency(results))),
        Section("Figs. 1 and 5: maps", list(_maps(maps))),
        Section("Consistency, steps and chassis: not in the paper", list(_beyond(results))),
        Section("Ablations", list(_ablations(results))),
        Section("Delays, clocks and long outages", list(_robustness(results))),
        Section("Switches and their reasons", [page_tables.switches(results, scenario) for scenario in TASKS]),
        Section("Machine and tuning", list(page_tables.about(results))),
    ]
    heading = "Holdfast: the paper's evaluation, rebuilt"
    return Page(heading, _lead(results), provenance, [section for section in sections if section.blocks])


def _lead(results: Results) -> str:
    """Return the results in three sentences."""
    cells = len(QUANTITIES) * len(TASKS)
    lost = {(one.scenario, one.quantity.key) for one in lost_cells(results)}
    failed = [task for task in TASKS if not results.of("accuracy", task, OURS)]
    lost |= {(task, quantity.key) for task in failed for quantity in QUANTITIES}
    lead = f"Both tasks of the paper on simulated recordings whose truth is known, {results.seeds} "
    lead += f"seed{'s' * (results.seeds > 1)} each" + (", shortened to be quick. " if results.quick else ". ")
    lead += f"In {cells - len(lost)} of {cells} rows of Table I (RMS) no baseline does better than ours"
    lead += "; in the others ours loses, as listed there. " if lost else ". "
    return lead + "The real recordings are in docs/results/real-drives.md."


def _accuracy(results: Results) -> Iterator[Block]:
    for line in failures(results):
        yield Text(f"Without a verdict: {line}", note=True)
    for scenario in TASKS:
        yield page_tables.table_one(results, scenario)
        yield Text(losses.accuracy_in_words(results, scenario), note=True)
    for scenario in TASKS:
        yield page_tables.table_one_whole(results, scenario)
    yield page_tables.targets(results)


def _latency(results: Results) -> Iterator[Block]:
    yield page_tables.table_two(results)
    yield from (Text(line, note=True) for line in losses.latency_in_words(results))
    yield page_figures.latency(results)


def _consistency(results: Results) -> Iterator[Block]:
    if "navigation" in page_figures.drawn(results):
        yield page_figures.figure_six(results)
    yield page_tables.consistency(results)
    yield from (Text(line, note=True) for line in losses.consistency_in_words(results))


def _outages(results: Results) -> Iterator[Block]:
    drawn = page_figures.drawn(results)
    yield from (page_figures.tracks(results, scenario) for scenario in drawn)
    if "construction" in drawn:
        yield from page_figures.figure_three(results)
    if "navigation" in drawn:
        yield page_figures.figure_four(results)
    yield page_tables.outages(results)


def _maps(maps: Maps | None) -> Iterator[Block]:
    if maps is None:
        return
    for score in maps:
        if score.failure:
            yield Text(f"No map of {score.scenario} with the poses of {title(score)}: {score.failure}", note=True)
    yield page_tables.maps_table(maps)
    yield from (Text(line, note=True) for line in losses.maps_in_words(maps))
    for scenario in TASKS:
        drawn = list(map_figures(tuple(score for score in maps if score.scenario == scenario)))
        if drawn:
            yield Row(drawn)


def _beyond(results: Results) -> Iterator[Block]:
    for scenario in page_figures.drawn(results):
        yield page_figures.consistency(results, scenario)
        yield page_figures.steps(results, scenario)
        found: list[Figure | None] = [page_figures.chassis(results, scenario), page_figures.gate(results, scenario)]
        yield from (figure for figure in found if figure is not None)


def _ablations(results: Results) -> Iterator[Block]:
    found: list[Table | None] = [page_tables.ablation(results, scenario) for scenario in TASKS]
    yield from (table for table in found if table is not None)


def _robustness(results: Results) -> Iterator[Block]:
    figure = page_figures.growth(results)
    if figure is not None:
        yield figure
    yield from page_figures.sensitivity(results)
