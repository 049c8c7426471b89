"""Metadata of a simulated recording: the simulator writes its seed into the MCAP."""

from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import SeekingReader

SIMULATION = "holdfast.simulation"


def read_origin(path: str | Path) -> dict[str, str]:
    """Return `seed` and `description` of a simulated recording, as text.

    Of one that was not simulated, is no MCAP, or was cut off, nothing is known.
    """
    path = Path(path)
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path] if path.suffix == ".mcap" else []
    for file in files:
        try:
            with file.open("rb") as stream:
                found = [one.metadata for one in SeekingReader(stream).iter_metadata() if one.name == SIMULATION]
        except (OSError, McapError):
            continue
        if found:
            return dict(found[0])
    return {}
