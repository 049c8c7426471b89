"""summary.json, read again."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from holdfast.errors import ConfigError, RecordingError
from holdfast.geometry.earth import Geodetic
from holdfast.replay.outputs import SUMMARY


def read_summary(folder: Path) -> dict[str, Any]:
    """Read summary.json.

    Raises:
        ConfigError: there is none.
        RecordingError: it is none.
    """
    file = folder / SUMMARY
    try:
        summary: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        missing = [
            key for key in ("recording", "counts", "timing", "held_out", "versions", "config") if key not in summary
        ]
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ConfigError(f"{file}: {reason} (allowed: a folder that `holdfast replay` has written)") from None
    except (json.JSONDecodeError, TypeError, UnicodeDecodeError):
        raise RecordingError(f"{file}: is no summary of a replay") from None
    if missing:
        raise RecordingError(f"{file}: is no summary of a replay: it has no {missing[0]!r}")
    return summary


def datum_in(summary: Mapping[str, Any]) -> Geodetic | None:
    """Return the origin of W of a run, as its summary has it; None where W is nowhere on the earth."""
    found = summary.get("datum")
    return None if found is None else Geodetic(**found)


def is_datum_given(summary: Mapping[str, Any]) -> bool:
    """Whether somebody said where the origin of W is; else it is at the first fix."""
    return bool(summary["config"].get("frames", {}).get("datum"))
