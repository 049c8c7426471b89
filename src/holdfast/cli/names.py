"""Names for paths in tables and figures."""

from pathlib import Path


def names_of(*paths: Path) -> tuple[str, ...]:
    """Return names of paths that tell them apart, as short as they can be."""
    parts = [path.resolve().parts for path in paths]
    for length in range(1, max(map(len, parts)) + 1):
        names = tuple("/".join(of[-length:]) for of in parts)
        if len(set(names)) == len(names):
            return names
    return tuple(str(path) for path in paths)
