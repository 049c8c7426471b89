"""Writes what a live node receives and publishes as MCAP, in a process of its own: a slow disk holds nobody up."""

from pathlib import Path
from time import monotonic

from holdfast.errors import ConfigError, RecordingError
from holdfast.live.feed import Consumer
from holdfast.recording.mcap_writer import McapWriter

FLUSH_S = 2.0
"""The most that a power cut can lose."""


def check_destination(path: str | Path) -> None:
    """Refuse a file that cannot be written, or read again by its name, or that is there already.

    Raises:
        ConfigError: the text gives the reason.
    """
    if Path(path).suffix != ".mcap":
        raise ConfigError(f"--record {path}: must end in .mcap")
    try:
        with Path(path).open("xb"):
            pass
        Path(path).unlink()
    except FileExistsError:
        raise ConfigError(f"--record {path}: is there already; choose another name") from None
    except OSError as error:
        raise ConfigError(f"--record {path}: cannot be written ({error.strerror})") from None


def record(consumer: Consumer, path: str) -> None:
    """Write every record until the feed ends.

    On a full disk the recording ends and the file is cut behind the last whole chunk: it stays readable.
    """
    try:
        with McapWriter(path) as writer:
            flushed = monotonic()
            for batch in consumer.batches(FLUSH_S):
                for entry in batch:
                    writer.write(entry.topic, entry.data, entry.type_name, entry.time_ns)
                if monotonic() - flushed > FLUSH_S:
                    flushed = monotonic()
                    writer.flush()
    except (OSError, RecordingError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        consumer.complain(f"{path}: the recording ends here ({reason}); the estimator goes on")
        for _ in consumer.batches():
            pass
