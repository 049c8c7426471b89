"""What a user reads when results cannot be written: one line that names the file."""

import json
from pathlib import Path
from typing import Any

from holdfast.output_folder import add_results, naming_the_output


def write_json(path: str | Path, content: dict[str, Any]) -> None:
    """Write a file for machines.

    Raises:
        ConfigError: it cannot be written.
    """
    with naming_the_output(path):
        Path(path).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        add_results(Path(path))
