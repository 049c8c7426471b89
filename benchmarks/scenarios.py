"""Prints how the estimator does on the simulator's scenarios, over seeds, beside what is to be reached.

`python benchmarks/scenarios.py --write` runs everything and puts the tables into docs/results/simulated-sites.md, which
says what each measure means; `--quick` is for a first look.
"""

import argparse
import pickle
import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import starmap
from pathlib import Path
from tempfile import TemporaryDirectory

from holdfast.config.load import config_of
from holdfast.evaluation.measures import MEASURES, Measure
from holdfast.sim.configuration import configuration_data
from holdfast.sim.scenario import load_scenario
from holdfast.trial.run import Trial, trials_of

PAGE = Path(__file__).parent.parent / "docs" / "results" / "simulated-sites.md"
BEGIN, END = "<!-- begin of `make scenarios` -->", "<!-- end of `make scenarios` -->"
TASKS = ("construction", "navigation")  # of the paper
OTHERS = ("tunnel", "liar", "late", "clocks", "moving-start", "rough")
OTHER_SEEDS = 3


@dataclass(frozen=True)
class Runs:
    """All trials of one scenario under one preset, in the order of their seeds."""

    scenario: str
    preset: str
    trials: tuple[Trial, ...]

    def scores(self, measure: Measure) -> list[float]:
        """Return one score per seed."""
        return [trial.verdict.scores[measure.key] for trial in self.trials]

    def cell(self, measure: Measure, sign: str) -> str:
        """Return mean and worst, in bold where they miss the target."""
        scores = self.scores(measure)
        return sign.join(
            text if measure.is_reached(score, self.scenario) else f"**{text}**"
            for score in (measure.mean(scores), measure.worst(scores))
            for text in [measure.text(score)]
        )


def trials(scenario: str, seed: int, presets: Sequence[str], keep: Path | None = None) -> list[Trial]:
    """Simulate a scenario once and estimate it under every preset; what `keep` holds already is not run again."""
    files = {preset: keep / f"{scenario}-{seed}-{preset}.pickle" for preset in presets} if keep else {}
    found = {preset: pickle.loads(file.read_bytes()) for preset, file in files.items() if file.exists()}
    missing = [preset for preset in presets if preset not in found]
    if missing:
        loaded = load_scenario(scenario)
        given = configuration_data(loaded, seed)
        configs = [config_of({"preset": preset} | given, scenario) for preset in missing]
        with TemporaryDirectory() as folder:
            found |= zip(missing, trials_of(loaded, seed, Path(folder), configs), strict=True)
        for preset in missing if keep else ():
            files[preset].write_bytes(pickle.dumps(found[preset]))
    return [found[preset] for preset in presets]


def run(
    scenarios: dict[str, int], presets: Sequence[str], jobs: int, first: int = 0, keep: Path | None = None
) -> Iterator[list[Runs]]:
    """Yield the runs of every scenario (name -> number of seeds, from the first on), one entry per preset."""
    tasks = [(scenario, first + seed) for scenario, seeds in scenarios.items() for seed in range(seeds)]
    with ProcessPoolExecutor(jobs) as pool:
        work = partial(trials, presets=presets, keep=keep)
        done = pool.map(work, *zip(*tasks, strict=True)) if jobs > 1 else starmap(work, tasks)
        for scenario, seeds in scenarios.items():
            rows = []
            for seed in range(seeds):
                rows.append(next(done))
                print(f"{scenario} {seed + 1}/{seeds}", file=sys.stderr, flush=True)
            of_presets = zip(*rows, strict=True)
            yield [Runs(scenario, preset, tuple(of)) for preset, of in zip(presets, of_presets, strict=True)]


def scenario_table(runs: Sequence[Runs]) -> Iterator[str]:
    """Yield one table in Markdown: a scenario, its measures, mean and worst under each preset."""
    seeds = len(runs[0].trials)
    heads = [f"{one.preset}: mean | worst" for one in runs]
    yield from _table(f"`{runs[0].scenario}`, {seeds} seed{'s' * (seeds > 1)}", heads, " | ", runs)


def overview_table(runs: Sequence[Runs]) -> Iterator[str]:
    """Yield one table in Markdown: measures, and mean and worst of many scenarios."""
    title = f"Other scenarios, {len(runs[0].trials)} seeds each, preset {runs[0].preset}: mean / worst"
    yield from _table(title, [f"`{one.scenario}`" for one in runs], " / ", runs)


def _table(title: str, heads: Sequence[str], sign: str, runs: Sequence[Runs]) -> Iterator[str]:
    """Yield a row per measure; `sign` stands between mean and worst."""
    head = " | ".join(heads)
    yield f"### {title}"
    yield ""
    yield f"| Measure | Unit | Target | {head} |"
    yield "|---|---|---|" + "---:|" * (head.count("|") + 1)
    for measure in MEASURES:
        cells = " | ".join(one.cell(measure, sign) for one in runs)
        yield f"| {measure.label} | {measure.unit} | {measure.target} | {cells} |"
    yield ""


def details(runs: Iterable[Runs]) -> Iterator[str]:
    """Yield what happened in every run: outages and events."""
    for one in runs:
        for trial in one.trials:
            yield f"{one.scenario}, {one.preset}, seed {trial.seed}: {trial.real_time_factor:.0f} x real time"
            for o in trial.verdict.outages:
                yield (
                    f"  outage {o.span.start_s:6.1f} to {o.span.end_s:6.1f} s{', faulty fixes' * o.has_faulty}: "
                    f"H {o.horizontal_rms_m * 1e3:.1f} mm (alone {o.alone_horizontal_rms_m * 1e3:.1f}), "
                    f"heading {o.heading_rms_deg:.3f} deg (alone {o.alone_heading_rms_deg:.3f}), "
                    f"settled {o.settled_s:.2f} s, used again {o.regained_s:.2f} s"
                )
            yield from (f"  {t:8.2f} {kind} {sensor} {reason}" for t, kind, sensor, reason in trial.events)


def with_tables(page: str, tables: str) -> str:
    """Return the page with the part between the markers replaced.

    Raises:
        ValueError: the page lacks the markers.
    """
    head, begin, rest = page.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the page must hold the lines {BEGIN!r} and {END!r}")
    return f"{head}{BEGIN}\n\n{tables}\n{END}{tail}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", help=f"default: {' '.join(TASKS)}, then {' '.join(OTHERS)}")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--presets", nargs="+", choices=["holdfast", "paper"], default=["holdfast", "paper"])
    parser.add_argument("--quick", action="store_true", help="the scenario `quick` alone, two seeds")
    parser.add_argument("--details", action="store_true", help="print every outage and event, too")
    parser.add_argument("--write", action="store_true", help=f"write the tables into docs/results/{PAGE.name}")
    parser.add_argument("--keep", type=Path, help="folder for finished runs of this state, which are not run again")
    options = parser.parse_args()
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    how = (options.jobs, options.first, options.keep)
    chosen = dict.fromkeys(["quick"] if options.quick else options.scenarios, 2 if options.quick else options.seeds)
    lines: list[str] = []
    for runs in run(chosen or dict.fromkeys(TASKS, options.seeds), options.presets, *how):
        lines += scenario_table(runs)
        if options.details:
            print("\n".join(details(runs)), file=sys.stderr)
    if not chosen:
        others = dict.fromkeys(OTHERS, min(OTHER_SEEDS, options.seeds))
        rest = [one for runs in run(others, options.presets[:1], *how) for one in runs]
        lines += overview_table(rest)
        if options.details:
            print("\n".join(details(rest)), file=sys.stderr)
    tables = "\n".join(lines)
    print(tables)
    if options.write:
        PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8"), tables.strip() + "\n"), encoding="utf-8")


if __name__ == "__main__":
    main()
