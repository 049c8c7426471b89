"""Progress in a pipe: a line per ten percent of what takes over ten seconds, and nothing of what does not."""

import io
import sys
from dataclasses import dataclass

import pytest

from holdfast.cli.progress import PipeLines, count_bar, duration, progress_bar, reading_bar


class Clock:
    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def lines_of(capsys: pytest.CaptureFixture[str], total_s: float, steps: int = 1000) -> list[str]:
    clock = Clock()
    lines = PipeLines("replaying", clock)
    for step in range(steps + 1):
        clock.seconds = total_s * step / steps
        lines.update(step / steps)
    out, err = capsys.readouterr()
    assert out == ""
    return err.splitlines()


def test_what_takes_less_than_ten_seconds_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert lines_of(capsys, 9.9) == []


def test_long_work_says_a_line_per_ten_percent_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    lines = lines_of(capsys, 1000.0)
    assert len(lines) == 10
    assert lines[0] == "replaying: 10 % after 2 min, about 15 min left"
    assert lines[-1] == "replaying: 100 % after 17 min"


def test_work_that_turns_out_long_says_its_first_line_after_ten_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    assert [line.split(" after")[0] for line in lines_of(capsys, 20.0)] == [
        f"replaying: {percent} %" for percent in (50, 60, 70, 80, 90, 100)
    ]


def test_steps_of_more_than_ten_percent_say_one_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert [line.split(" after")[0] for line in lines_of(capsys, 90.0, 3)] == [
        f"replaying: {percent} %" for percent in (30, 60, 100)
    ]


def test_going_back_and_beyond_the_end_repeats_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    lines = PipeLines("reading", clock)
    for seconds, fraction in ((30.0, 0.5), (40.0, 0.2), (50.0, 0.5), (60.0, 1.5), (70.0, 2.0)):
        clock.seconds = seconds
        lines.update(fraction)
    assert capsys.readouterr().err.splitlines() == [
        "reading: 50 % after 30 s, about 30 s left",
        "reading: 100 % after 60 s",
    ]


def test_in_a_pipe_the_bars_feed_the_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.setattr("holdfast.cli.progress.QUIET_S", 0.0)
    with progress_bar("replaying", 1000, 2000) as show:
        assert show is not None
        show(1499)
        show(1500)
    with count_bar("evaluating") as count:
        assert count is not None
        count(3, 4)
    assert [line.split(" after")[0] for line in sys.stderr.getvalue().splitlines()] == [
        "replaying: 40 %",
        "replaying: 50 %",
        "evaluating: 70 %",
    ]


@dataclass
class Recorded:
    start_ns: int | None = 0
    end_ns: int | None = 600 * 10**9


def test_of_a_window_the_window_is_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """A replay of the first 200 s of 600 ended at 33 %."""
    monkeypatch.setattr("holdfast.cli.progress.QUIET_S", 0.0)
    for start_s, duration_s, read_to_s in ((0.0, 200.0, 200.0), (100.0, 200.0, 300.0), (500.0, 200.0, 600.0)):
        monkeypatch.setattr(sys, "stderr", io.StringIO())
        with reading_bar("replaying", Recorded(), start_s, duration_s) as show:  # type: ignore[arg-type]
            assert show is not None
            show(round(read_to_s * 1e9))
        assert sys.stderr.getvalue().startswith("replaying: 100 %")
    with reading_bar("replaying", Recorded(end_ns=None)) as show:  # type: ignore[arg-type]
        assert show is None


def test_a_recording_of_unknown_length_shows_nothing() -> None:
    with progress_bar("reading", 0, None) as show:
        assert show is None


@pytest.mark.parametrize(("seconds", "text"), [(3.4, "3 s"), (99.0, "99 s"), (150.0, "2 min"), (9000.0, "2.5 h")])
def test_times_are_told_as_people_say_them(seconds: float, text: str) -> None:
    assert duration(seconds) == text
