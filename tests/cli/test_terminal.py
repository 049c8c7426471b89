"""Nothing that an input holds reaches the terminal raw, by whatever way it is printed."""

import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest

from holdfast.cli import main, terminal
from holdfast.errors import ConfigError
from holdfast.recording.mcap_writer import McapWriter

EVIL = "\x1b]0;owned\x07\x1b[2J/imu\x1b[31m\x9b1A\r"
SOURCES = sorted((Path(__file__).parents[2] / "src").rglob("*.py"))
RAW = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


class Screen(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


def screen_of(monkeypatch):
    stream = Screen()
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


def test_what_is_echoed_is_escaped(monkeypatch):
    screen = screen_of(monkeypatch)
    with terminal.guarded():
        click.echo(EVIL)
        click.echo(EVIL, err=True)
    assert RAW.search(screen.getvalue()) is None
    assert r"\x1b]0;owned\x07" in screen.getvalue()


def test_a_table_on_a_terminal_has_its_colours_and_none_of_the_text_s(monkeypatch):
    screen = screen_of(monkeypatch)
    from rich.table import Table

    with terminal.guarded():
        table = Table("topic", title=EVIL)
        table.add_row(EVIL, style="bold")
        console = terminal.guarded_console(width=200, force_terminal=True)
        console.print(table)
        console.print(EVIL)
    printed = screen.getvalue()
    assert "\x1b[1m" in printed  # ours
    assert RAW.search(re.sub(r"\x1b\[[0-9;]*m", "", printed)) is None
    assert "\x1b[31m" not in printed and r"\x1b[31m" in printed


def test_a_console_that_is_not_ours_cannot_set_a_title_or_clear_the_screen_either(monkeypatch):
    screen = screen_of(monkeypatch)
    from rich.console import Console

    with terminal.guarded():
        Console(force_terminal=True, width=200).print(EVIL, style="bold", markup=False)
    assert "\x1b[1m" in screen.getvalue()
    assert "\x1b]" not in screen.getvalue() and "\x1b[2J" not in screen.getvalue()


def test_every_console_is_ours():
    texts = {path.name: path.read_text() for path in SOURCES}
    assert [name for name, text in texts.items() if re.search(r"\bConsole\(", text)] == []
    assert "class GuardedConsole(Console)" in texts["terminal.py"]


def run(arguments, monkeypatch, capfd):
    monkeypatch.setattr(sys, "argv", ["holdfast", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
        raise SystemExit(0)
    caught = capfd.readouterr()
    return ended.value.code, caught.out + caught.err


def test_a_topic_with_control_characters_is_shown_escaped_and_forges_no_line(tmp_path, monkeypatch, capfd):
    bag = tmp_path / "evil.mcap"
    with McapWriter(bag) as writer:
        imu = writer.types["sensor_msgs/msg/Imu"]
        stamp = writer.types["builtin_interfaces/msg/Time"]
        vector, turn = writer.types["geometry_msgs/msg/Vector3"], writer.types["geometry_msgs/msg/Quaternion"]
        header = writer.types["std_msgs/msg/Header"]
        for k in range(30):
            frame = EVIL if k % 2 else "imu\nerror: forged"
            message = imu(
                header(stamp(1 + k, 0), frame), turn(0.0, 0.0, 0.0, 1.0), np.zeros(9),
                vector(0.0, 0.0, 0.0), np.zeros(9),
                vector(0.0, 0.0, 9.81), np.zeros(9),
            )  # fmt: skip
            writer.write("/imu\nerror: forged" + EVIL, message, "sensor_msgs/msg/Imu", (1 + k) * 10**9)
    for arguments in (["info", bag], ["config", "init", bag]):
        code, printed = run(arguments, monkeypatch, capfd)
        assert code == 0
        assert RAW.search(printed) is None
        assert not re.search(r"^error: forged", printed, re.MULTILINE)
        assert r"\x1b]0;owned" in printed
    (tmp_path / "c.yaml").write_text("sensors: {imu: {kind: imu, topic: /other}}")
    code, printed = run(["replay", bag, "-c", tmp_path / "c.yaml", "-o", tmp_path / "out"], monkeypatch, capfd)
    assert code != 0
    assert RAW.search(printed) is None and not re.search(r"^error: forged", printed, re.MULTILINE)


def test_a_file_name_that_is_no_text_is_one_line(tmp_path, monkeypatch, capfd):
    code, printed = run(["info", f"{tmp_path}/\udcff\x1b[2J.bag"], monkeypatch, capfd)
    assert (code, printed) == (3, f"error: {tmp_path}/\\udcff\\x1b[2J.bag: no such file or folder\n")


def test_an_error_is_cut_where_nobody_reads_on(monkeypatch, capfd):
    def fail(**_):
        raise ConfigError("x" * 10**6)

    monkeypatch.setattr("holdfast.cli.holdfast", fail)
    code, printed = run(["info"], monkeypatch, capfd)
    assert code == 2 and len(printed) < terminal.MAX_LINE + 100 and "998000 characters more" in printed


PROGRAM = [sys.executable, "-c", "from holdfast.cli import main; main()", "evaluate", "a.tum", "a.tum"]


@pytest.fixture
def track(tmp_path):
    (tmp_path / "a.tum").write_text("".join(f"{k}.5 {k} 0 0 0 0 0 1\n" for k in range(5)))
    return tmp_path


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere no device is always full")
@pytest.mark.parametrize("command", [PROGRAM, [*PROGRAM[:3], "--help"]])
def test_where_nothing_can_be_printed_any_more_that_is_one_line(track, command):
    """`holdfast info DRIVE > LIST` on a full disk ended in a traceback."""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, cwd=track, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "error: the output: cannot be written or read (No space left on device)\n"


def test_a_stream_that_is_closed_swallows_what_is_printed(track):
    """Where a service manager gives no stdout, results were written and the end was a traceback."""
    for closed in (">&-", "2>&-", ">&- 2>&-"):
        command = shlex.join([*PROGRAM, "--json", "a.json"])
        done = subprocess.run(f"{command} {closed}", shell=True, capture_output=True, cwd=track, text=True, check=False)
        assert (done.returncode, "Traceback" in done.stderr) == (0, False)
        (track / "a.json").unlink()


def test_a_reader_that_has_read_enough_of_a_table_is_no_failure(track):
    """rich ended with 1, all other output with 0."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(PROGRAM, stdout=writer, stderr=subprocess.PIPE, cwd=track, text=True, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")
