"""Numbers for other programs, as JSON."""

import json
from pathlib import Path
from typing import Any

from holdfast.output_folder import add_results
from holdfast.whole_file import write_whole


def write_json(path: str | Path, content: dict[str, Any]) -> None:
    """Write a file for machines.

    Raises:
        ConfigError: it cannot be written.
    """
    write_whole(path, json.dumps(content, indent=2) + "\n")
    add_results(Path(path))
