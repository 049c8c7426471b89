"""What is a number in a text file: `int` and `float` of Python take 1_000 and the digits of every script as well."""

from collections.abc import Sequence


def check_plain(cells: Sequence[str]) -> None:
    """Refuse cells that only Python takes for numbers.

    Raises:
        ValueError: as `float` does.
    """
    text = "".join(cells)
    if "_" in text or not text.isascii():
        raise ValueError(text)
