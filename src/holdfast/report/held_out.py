"""Errors at positions that were held back from the estimator, in rows: the same on a page and on a terminal."""

from collections.abc import Mapping
from typing import Any

from holdfast.report.page import Cell

COLUMNS = (
    "track",
    "when",
    "positions",
    "horizontal RMS [m]",
    "p95 [m]",
    "max [m]",
    "vertical RMS [m]",
    "max [m]",
    "NEES / 3",
)
TRACKS = {"causal": "as published", "smoothed": "as it left the window", "batch": "the optimum over the recording"}


def held_out_rows(summary: Mapping[str, Any]) -> list[list[Cell]]:
    """Return a row for each track and circumstance that a summary knows, in the order of `COLUMNS`."""
    return [
        [track, part, of["horizontal_m"]["count"], *(of["horizontal_m"][key] for key in ("rms", "p95", "max")),
         *(of["vertical_m"][key] for key in ("rms", "max")), of["nees_per_dof"]]
        for track, parts in summary["held_out"].items()
        for part, of in (parts or {}).items()
    ]  # fmt: skip


def tracks_in_words(summary: Mapping[str, Any]) -> str:
    """Return what the tracks are that a summary knows, as a sentence."""
    known = [track for track in TRACKS if summary["held_out"].get(track)]
    return "; ".join(f"{track}: {TRACKS[track]}" for track in known) + "."
