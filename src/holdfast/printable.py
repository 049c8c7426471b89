"""Text that comes from a file or the network, made fit to be printed: on one line, nothing hidden, not too long.

Names of topics and frames, file names, values of a configuration: whoever wrote them may have put in what clears a
terminal, sets its title, or looks like a line of ours.
"""

import re

QUOTED = 200
"""How much of an input an error quotes at most, in characters."""
_SUSPECT = re.compile(r"[^ -~]")


def one_line(text: str, limit: int | None = None) -> str:
    """Return text with all that would break a line or hide escaped, as Python writes it; cut at `limit` characters."""
    escaped = _SUSPECT.sub(lambda found: _escaped(found[0]), text if limit is None else text[: limit + 1])
    return escaped if limit is None or len(escaped) <= limit else escaped[: limit - 3] + "..."


def first_line(error: Exception) -> str:
    """Return the first line of what an exception says, or its name."""
    return (str(error).strip() or repr(error)).splitlines()[0]


def quoted(value: object) -> str:
    """Return what an error quotes of an input: its text on one line, at most `QUOTED` characters."""
    return one_line(str(value), QUOTED)


def listed(names: list[str], limit: int = 20) -> str:
    """Return names with commas between them, and how many more there are."""
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(map(quoted, names[:limit])) + more


def _escaped(character: str) -> str:
    return character if character.isprintable() else character.encode("unicode_escape").decode()
