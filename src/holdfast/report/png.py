"""Pixels as a PNG file, without a library of images (PNG specification, third edition, sections 5 to 11)."""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
COLOUR_TYPES = {3: 2, 4: 6}  # RGB, RGBA


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """Return an image (H, W, 3 or 4) of 8 bits per channel as PNG, its first row on top.

    Raises:
        ValueError: the shape is none of an image.
    """
    if image.ndim != 3 or image.shape[2] not in COLOUR_TYPES:
        raise ValueError(f"an image has shape (H, W, 3 or 4), not {image.shape}")
    height, width, channels = image.shape
    rows = image.reshape(height, width * channels)
    unfiltered = np.hstack([np.zeros((height, 1), dtype=np.uint8), rows]).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, COLOUR_TYPES[channels], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(unfiltered, 9)), (b"IEND", b""))
    return SIGNATURE + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
