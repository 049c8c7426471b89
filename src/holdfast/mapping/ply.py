"""The map as binary PLY in W."""

from pathlib import Path

import numpy as np

from holdfast.mapping.colours import Colouring
from holdfast.mapping.site_map import SiteMap

COLUMNS = {
    "x": "double",
    "y": "double",
    "z": "double",
    "red": "uchar",
    "green": "uchar",
    "blue": "uchar",
    "intensity": "float",
    "sigma_m": "float",
    "scans": "uint",
}
FORMATS = {"double": "<f8", "uchar": "u1", "float": "<f4", "uint": "<u4"}


def write_ply(site_map: SiteMap, colouring: Colouring, file: Path) -> None:
    """Write a vertex per point, block by block.

    Raises:
        OSError: the file cannot be written.
    """
    layout = np.dtype([(name, FORMATS[kind]) for name, kind in COLUMNS.items()])
    with file.open("wb") as stream:
        lines = ["ply", "format binary_little_endian 1.0", "comment W: east, north, up of the datum [m]"]
        lines += [f"element vertex {site_map.points}"]
        lines += [f"property {kind} {name}" for name, kind in COLUMNS.items()]
        stream.write("\n".join([*lines, "end_header\n"]).encode())
        for block in site_map.blocks():
            rows = np.empty(len(block), dtype=layout)
            for axis, name in enumerate("xyz"):
                rows[name] = block["point"][:, axis]
            for channel, name in zip(colouring.colours(block).T, ("red", "green", "blue"), strict=True):
                rows[name] = channel
            for name in ("intensity", "sigma_m", "scans"):
                rows[name] = block[name]
            rows.tofile(stream)
