"""What a user reads when results cannot be written: one line that names the file."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from holdfast.errors import ConfigError
from holdfast.output_folder import add_results


@contextmanager
def naming_the_output(output: str | Path) -> Iterator[None]:
    """Report a full disk and other failures to write in one line.

    Raises:
        ConfigError: names the file, or the output if the system does not name one.
    """
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{error.filename or output}: cannot be written ({error.strerror or error})") from None


def check_folder_of(path: str | Path) -> None:
    """Refuse a file in a folder that is not there, before long work.

    Raises:
        ConfigError: names the file.
    """
    if not Path(path).absolute().parent.is_dir():
        raise ConfigError(f"{path}: cannot be written (its folder does not exist)")


def write_json(path: str | Path, content: dict[str, Any]) -> None:
    """Write a file for machines.

    Raises:
        ConfigError: it cannot be written.
    """
    with naming_the_output(path):
        Path(path).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        add_results(Path(path))
