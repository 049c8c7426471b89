"""Fuzzes one target for a while: `python tests/fuzz/fuzz.py TARGET --seconds 600`.

With `atheris` (in the extra dev, where it has a wheel) the search follows the coverage of Holdfast, rosbags and ruamel,
from the seeds and the corpus; without, it mutates them at random. What breaks a bound is written to the corpus, where
the tests find it, and ends the run with exit code 1.
"""

import argparse
import hashlib
import os
import random
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

HERE = Path(__file__).parent
WORK = HERE.parents[1] / ".fuzz"
MAX_BYTES = 65_536
TIMEOUT_S = 300
"""On the wall, of an input that never ends; the targets bound what an input takes of the processor."""
KEPT_BYTES = 20_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target")
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--seed", type=int, default=0, help="of the random numbers; 0: another every time")
    parser.add_argument("--keep", action="store_true", help="copy the smallest inputs that were found to the corpus")
    options = parser.parse_args()
    if options.keep:
        keep(options.target)
        return
    try:
        import atheris

        from holdfast import kernel
    except ModuleNotFoundError:
        fuzz_at_random(options.target, options.seconds, options.seed or random.SystemRandom().randrange(1, 1 << 30))
        return
    for module in iter_modules(kernel.__path__, "holdfast.kernel."):  # numba cannot compile what is instrumented
        import_module(module.name)
    with atheris.instrument_imports(include=["holdfast", "rosbags", "ruamel"]):
        from seeds import seeds
        from targets import TARGETS, check
    if options.target not in TARGETS:
        sys.exit(f"{options.target}: there are {', '.join(TARGETS)}")
    folder = WORK / options.target  # what libFuzzer finds new grows here
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in seeds(options.target).items():
        (folder / f"seed-{name}").write_bytes(data)
    corpus = HERE / "corpus" / options.target
    corpus.mkdir(parents=True, exist_ok=True)
    arguments = [f"-max_total_time={options.seconds}", f"-timeout={TIMEOUT_S}", f"-max_len={MAX_BYTES}"]
    arguments += [f"-artifact_prefix={corpus}/", "-rss_limit_mb=3000", "-print_final_stats=1", "-verbosity=0"]
    arguments += [f"-seed={options.seed}"] if options.seed else []
    atheris.Setup([sys.argv[0], *arguments, str(folder), str(corpus)], lambda data: run(check, options.target, data))
    atheris.Fuzz()


def keep(target: str) -> None:
    """Copy the smallest of what was found in earlier runs to the corpus of the repository."""
    corpus, size = HERE / "corpus" / target, 0
    corpus.mkdir(parents=True, exist_ok=True)
    found = [file for file in (WORK / target).iterdir() if not file.name.startswith("seed-")]
    for file in sorted(found, key=lambda file: file.stat().st_size):
        size += file.stat().st_size
        if size > KEPT_BYTES:
            break
        (corpus / file.name).write_bytes(file.read_bytes())


def run(check: Callable[[str, bytes], None], target: str, data: bytes) -> None:
    """Check one input; what breaks a bound is kept, and ends the process."""
    try:
        check(target, data)
    except BaseException:
        found = HERE / "corpus" / target / f"crash-{hashlib.sha1(data).hexdigest()}"
        found.parent.mkdir(parents=True, exist_ok=True)
        found.write_bytes(data)
        traceback.print_exc()
        print(f"{target}: breaks a bound: {found}", file=sys.stderr, flush=True)
        os._exit(1)


def fuzz_at_random(target: str, seconds: float, seed: int) -> None:
    from mutate import mutated
    from seeds import seeds
    from targets import check

    randomness, corpus = random.Random(seed), HERE / "corpus" / target
    pool = [*seeds(target).values(), *(file.read_bytes() for file in corpus.glob("*"))]
    until_s, count = time.monotonic() + seconds, 0
    print(f"{target}: at random, seed {seed}", flush=True)
    while time.monotonic() < until_s:
        data, count = mutated(randomness, pool), count + 1
        run(check, target, data)
    print(f"{target}: {count} inputs, none breaks a bound")


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main()
