"""Work in processes: everything comes back, a failure or Ctrl-C ends the others, a killed process is reported."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from multiprocessing import active_children
from pathlib import Path

import pytest

from holdfast.errors import ConfigError, HoldfastError
from holdfast.trial.pool import processes, run_all

SLEEPERS = """
import time
from functools import partial
from holdfast.trial.pool import processes, run_all

def main():
    with processes(2, "lost") as pool:
        print("ready", flush=True)
        run_all(pool, [partial(time.sleep, 60.0)] * 2, lambda came: print("polled", flush=True))

if __name__ == "__main__":
    main()
"""


def refuse(text: str) -> None:
    raise ConfigError(text)


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_every_result_comes_once():
    came: list[int] = []
    with processes(2, "lost") as pool:
        run_all(pool, [partial(abs, -number) for number in range(5)], came.extend)
        run_all(pool, [partial(abs, -5)], came.extend)
    assert sorted(came) == [0, 1, 2, 3, 4, 5]


def test_the_first_that_raises_ends_the_others():
    others = set(active_children())
    began = time.monotonic()
    with pytest.raises(ConfigError, match="no such thing"), processes(2, "lost") as pool:
        run_all(pool, [partial(time.sleep, 60.0), partial(refuse, "no such thing")], lambda _: None)
    assert time.monotonic() - began < 30.0
    assert not set(active_children()) - others


def test_a_killed_process_is_reported_in_the_words_of_the_caller():
    others = set(active_children())
    with pytest.raises(HoldfastError, match="what is done is kept"), processes(1, "what is done is kept") as pool:
        run_all(pool, [die], lambda _: None)
    assert not set(active_children()) - others


def test_ctrl_c_ends_all_without_words_of_the_workers(tmp_path):
    script = tmp_path / "sleepers.py"
    script.write_text(SLEEPERS, encoding="utf-8")
    started = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert started.stdout is not None
        assert [started.stdout.readline() for _ in range(2)] == ["ready\n", "polled\n"]
        os.killpg(started.pid, signal.SIGINT)  # as a terminal does: to the whole group
        _, printed = started.communicate(timeout=30.0)
    finally:
        started.kill()
    assert printed.count("Traceback") == 1  # of the one that answers
    assert printed.rstrip().endswith("KeyboardInterrupt")


@pytest.mark.skipif(not Path("/proc").exists(), reason="asks /proc who is there")
def test_no_process_of_a_pool_outlives_the_one_that_started_it(tmp_path):
    script = tmp_path / "sleepers.py"
    script.write_text(SLEEPERS)
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    assert parent.stdout.readline() == "ready\n"
    until_s = time.monotonic() + 60.0
    while len(workers_of(script)) < 2 and time.monotonic() < until_s:
        time.sleep(0.05)
    assert parent.stdout.readline() == "polled\n"
    children = workers_of(script)
    assert len(children) == 2
    parent.kill()
    parent.wait()
    while alive(children) and time.monotonic() < until_s:
        time.sleep(0.05)
    assert not alive(children)


def workers_of(script):
    """Processes that `multiprocessing` spawned for a script: it names the parent's number in their arguments."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if str(script).encode() in Path(f"/proc/{parent}/cmdline").read_bytes():
                command = (folder / "cmdline").read_bytes()
                found |= {int(folder.name)} if b"spawn_main" in command else set()
        except (OSError, ValueError):
            continue
    return found


def alive(numbers):
    states = []
    for number in numbers:
        try:
            states.append(Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0])
        except OSError:
            continue
    return [state for state in states if state != "Z"]
