"""Unpacks the chunks of bags, within bounds: half a megabyte can claim to be gigabytes, and zeros even are.

rosbags decompresses whatever comes; `bound_rosbags` gives its tables decompressors that stop.
"""

import sys
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import storage_mcap

from holdfast.errors import RecordingError

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdDecompressor
else:
    from backports.zstd import ZstdDecompressor

MAX_RATIO = 100
"""What an honest chunk is larger than its packed bytes at most, beyond the sizes below."""
MAX_CHUNK_BYTES = 64 << 20
MAX_FILE_BYTES = 256 << 20
MAX_FRAMES = 1000
"""An honest chunk is one."""
STEP_BYTES = 4 << 20


class OversizedError(RecordingError):
    """A file unpacks to far more than it is: it was made to fill the memory."""


def unpack(compression: str, data: bytes, size: int | None = None) -> bytes:
    """Return the content of a chunk.

    Args:
        compression: `zstd`, `lz4`, `bz2`, or nothing.
        data: as they stand in the file.
        size: what the chunk claims to be [bytes]; no more is unpacked.

    Raises:
        OversizedError: it is, or claims to be, far more than its packed bytes.
        ValueError: it is damaged, or packed otherwise; the libraries raise errors of their own, too.
    """
    if compression in ("", "none"):
        return data
    if compression not in DECOMPRESSORS:
        raise ValueError(f"compression {compression!r} is not supported")
    check_size(len(data), size or 0, MAX_CHUNK_BYTES)
    limit = max(MAX_CHUNK_BYTES, MAX_RATIO * len(data)) if size is None else size
    return b"".join(_frames(DECOMPRESSORS[compression], data, limit))


def check_size(packed: int, unpacked: int, always_allowed: int) -> None:
    """Refuse what is far larger than its packed bytes; all numbers in bytes.

    Raises:
        OversizedError: one line without the file.
    """
    if unpacked > max(always_allowed, MAX_RATIO * packed):
        raise OversizedError(f"{packed} bytes claim to unpack to {unpacked} bytes (allowed: {MAX_RATIO} times as many)")


def bound_rosbags() -> None:
    """Let rosbags unpack chunks by `unpack`."""
    for name in ("zstd", "lz4"):
        storage_mcap.DECOMPRESSORS[name] = partial(unpack, name)
    for name in ("bz2", "lz4"):
        rosbag1.decompressors[name] = partial(unpack, name)


DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": ZstdDecompressor,
    "lz4": LZ4FrameDecompressor,
    "bz2": BZ2Decompressor,
}


def _frames(make: Callable[[], Any], data: bytes, limit: int) -> Iterable[bytes]:
    size = 0
    for _ in range(MAX_FRAMES):
        decompressor = make()
        part: bytes = decompressor.decompress(data, max_length=STEP_BYTES)
        while part:
            size += len(part)
            if size > limit:
                raise OversizedError(f"a chunk unpacks to more than {limit} bytes")
            yield part
            part = b"" if decompressor.eof else decompressor.decompress(b"", max_length=STEP_BYTES)
        if not decompressor.eof:
            raise ValueError("the packed bytes of a chunk end too early")
        data = decompressor.unused_data or b""
        if not data:
            return
    raise ValueError(f"a chunk is packed in more than {MAX_FRAMES} frames")
