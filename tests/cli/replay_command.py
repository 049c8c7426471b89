"""`holdfast replay` in a process of its own, and what a mistake may print."""

import subprocess
import sys

COMMAND = [sys.executable, "-c", "from holdfast.cli import main; main()", "replay"]


def run_command(*arguments):
    """Run the real command in a process of its own, with its output in a pipe."""
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=60)


def assert_one_error(done, code, *words):
    """One line on stderr, with the words in it, nothing on stdout, no traceback."""
    lines = (done.err if hasattr(done, "err") else done.stderr).splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    for word in words:
        assert str(word) in lines[0]
    assert (done.code if hasattr(done, "code") else done.returncode) == code
    assert (done.out if hasattr(done, "out") else done.stdout) == ""
