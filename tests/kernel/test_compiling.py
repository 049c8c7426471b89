"""Compiled once per machine: where the machine code lies, and who never needs it."""

import os
import subprocess
import sys
import tempfile

import pytest

from holdfast.kernel import compiling

COMPILE = """
import numba
from holdfast.kernel.compiling import entry
print(entry(numba.int64, numba.int64)(lambda x: x + 41)(1))
"""


def python(program, **environment):
    command = [sys.executable, "-c", program]
    found = subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | environment, timeout=120
    )
    assert found.returncode == 0, found.stderr
    return found


@pytest.mark.parametrize(
    "arguments", [["--help"], ["replay", "--help"], ["info", "kitti", "--duration", "5"], ["config", "check", "FILE"]]
)
def test_what_estimates_nothing_does_not_import_the_compiler(arguments, tmp_path):
    config = tmp_path / "machine.yaml"
    config.write_text("sensors:\n  imu: {kind: imu, topic: /imu}\n  fix: {kind: gnss, topic: /fix, frame: imu}\n")
    done = python(
        f"""
import sys
from holdfast.cli import main
sys.argv = ["holdfast", *{[str(config) if word == "FILE" else word for word in arguments]!r}]
try:
    main()
except SystemExit as ended:
    assert not ended.code, ended.code
print("numba" in sys.modules)
"""
    )
    assert done.stdout.splitlines()[-1] == "False"


def test_the_first_time_on_a_machine_says_what_takes_so_long_and_the_second_says_nothing(tmp_path):
    place = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert python("import holdfast.kernel.compiling", **place).stderr == f"{compiling.MESSAGE}\n"
    assert python("import holdfast.kernel.compiling", **place).stderr == ""


def test_code_that_cannot_be_kept_among_the_caches_lies_among_the_temporary_files_where_nobody_else_writes(tmp_path):
    place = {"NUMBA_CACHE_DIR": "/proc/nowhere", "TMPDIR": str(tmp_path)}
    first, second = (python("from holdfast.kernel.compiling import FOLDER; print(FOLDER)", **place) for _ in range(2))
    (mine,) = tmp_path.iterdir()
    assert mine.stat().st_mode & 0o777 == 0o700
    assert first.stdout == second.stdout and first.stdout.startswith(f"{mine}/")
    assert (first.stderr, second.stderr) == (f"{compiling.MESSAGE}\n", "")


@pytest.mark.parametrize(
    "spoil", [lambda mine: mine.chmod(0o777), lambda mine: mine.rename("x") and mine.symlink_to("x")]
)
def test_a_temporary_folder_that_others_could_write_to_is_not_used(spoil, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/nowhere")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert compiling._folder() is not None
    (mine,) = tmp_path.iterdir()
    spoil(mine)
    assert compiling._folder() is None


def test_code_that_can_be_kept_nowhere_is_no_error():
    done = python(f"import tempfile; tempfile.tempdir = '/proc/nowhere'\n{COMPILE}", NUMBA_CACHE_DIR="/proc/nowhere")
    assert done.stdout == "42\n"
    assert done.stderr == f"{compiling.MESSAGE} (its cache cannot be written: each time)\n"


def test_machine_code_of_other_sources_is_not_taken(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    room = tmp_path / "kernel"
    room.mkdir()
    monkeypatch.setattr(compiling, "HERE", room)
    (room / "called.py").write_text("A = 1\n")
    first = compiling._folder()
    assert compiling._folder() == first
    (room / "called.py").write_text("A = 2\n")
    assert compiling._folder() != first
