"""Every decoder and the configuration on its seeds, on what fuzzing found, and on some mutations."""

import random
import sys
import warnings
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
from mutate import mutated
from seeds import seeds
from targets import TARGETS, OutOfBoundsError, check

CORPUS = Path(__file__).parent / "corpus"
MUTATIONS = 30


def kept(target):
    return sorted((CORPUS / target).glob("*"))


@pytest.mark.parametrize("target", TARGETS)
def test_the_seeds_are_accepted_and_what_fuzzing_has_found_keeps_the_bounds(target):
    for data in seeds(target).values():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            TARGETS[target](data)
    for file in kept(target):
        check(target, file.read_bytes())


@pytest.mark.parametrize("target", TARGETS)
def test_mutations_of_the_seeds_keep_the_bounds(target):
    randomness, pool = random.Random(0), list(seeds(target).values())
    for _ in range(MUTATIONS):
        check(target, mutated(randomness, pool))


def test_the_corpus_is_small():
    assert sum(file.stat().st_size for target in TARGETS for file in kept(target)) < 300_000


@pytest.mark.parametrize(("body", "words"), [
    (lambda _: [].pop(), "pop from empty"),
    (lambda _: b"x" * (200 << 20), "of memory"),
])  # fmt: skip
def test_the_bounds_are_checked(monkeypatch, body, words):
    monkeypatch.setitem(TARGETS, "config", body)
    with pytest.raises((OutOfBoundsError, IndexError), match=words):
        check("config", b"abc")


def test_make_fuzz_runs_every_target():
    makefile = (Path(__file__).parents[2] / "Makefile").read_text()
    line = next(line for line in makefile.splitlines() if line.startswith("FUZZ_TARGETS := "))
    assert line.split()[2:] == list(TARGETS)
