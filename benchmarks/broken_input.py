"""Gives every kind of broken input that the tests know to commands in processes of their own, and counts tracebacks.

`python benchmarks/broken_input.py` prints what `grep -ci traceback` would find in all that they print: 0. Some minutes.
"""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

TESTS = Path(__file__).parents[1] / "tests"
HOLDFAST = [sys.executable, "-c", "from holdfast.cli import main; main()"]
PATIENCE_S = 300.0


def main() -> int:
    sys.path += [str(TESTS / room) for room in ("cli", "replay", "recording")]
    from test_broken_input import CASES, NUMBERS, make_sound

    commands = {name: (break_it, command) for name, (break_it, command, _, _) in CASES.items()}
    commands |= {name: (break_it, "replay csv -c machine.yaml -o out") for name, break_it in NUMBERS.items()}
    found = 0
    with TemporaryDirectory() as folder:
        sound = make_sound(Path(folder) / "sound")
        for number, (name, (break_it, command)) in enumerate(commands.items()):
            place = Path(folder) / str(number)
            shutil.copytree(sound, place)
            os.chdir(place)
            break_it()
            done = subprocess.run(
                [*HOLDFAST, *shlex.split(command)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
            )
            lines = (done.stdout + done.stderr).lower().splitlines()
            if count := sum("traceback" in line for line in lines):
                print(f"{name}: {command}: {done.stderr.splitlines()[-1]}", flush=True)
                found += count
            os.chdir(folder)
            shutil.rmtree(place)
    print(f"{len(commands)} kinds of broken input: {found} tracebacks")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
