"""Whether the scans of a recording can close loops, and what does it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.config.model import Config
from holdfast.recording.kinds.scans import POINT_CLOUD
from holdfast.recording.raw import RawBag
from holdfast.recording.source import Recording

if TYPE_CHECKING:
    from holdfast.loops.closer import LoopCloser


@contextmanager
def loop_closer(
    path: str | Path, recording: Recording, config: Config, stamp: Callable[[int], int]
) -> "Iterator[LoopCloser | None]":
    """Open what closes loops; None where it is switched off, or without scans or small_gicp.

    Of several topics of clouds the first by name is taken.

    Args:
        path: of the recording.
        recording: the same, open.
        config: of the estimator.
        stamp: maps a time of the estimator [ns] to a stamp of the recording.

    Raises:
        RecordingError: the bag cannot be read.
    """
    topics = sorted(info.topic for info in recording.topics if info.type == POINT_CLOUD)
    if not config.smoothing.loop_closures or not topics or find_spec("small_gicp") is None:
        yield None
        return
    from holdfast.loops.closer import LoopCloser

    with RawBag(path) as bag:
        yield LoopCloser(bag, topics[0], config, stamp)
