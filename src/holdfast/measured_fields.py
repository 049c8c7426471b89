"""What the fields of a message must be, the error that names the one which is not, and those that may be absent."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, NoReturn, TypeGuard

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import MessageError

LIMIT_NS = 2**63
NEVER_NS = -LIMIT_NS
"""Before all stamps: 0 is one like any other, to a clock that runs from the boot or has wrapped around."""
TEXT_CHARACTERS = 40
NUMBERS = (float, int, np.floating, np.integer)
WHOLE = (int, np.integer)
REAL_KINDS = "fiu"  # of a dtype: neither text nor truth values nor complex numbers, which numpy would convert


class Quantity(NamedTuple):
    """An array of a shape, or a number where the shape is (); the unit as people write it."""

    shape: tuple[int, ...]
    unit: str
    may_be_none: bool = False

    def __str__(self) -> str:
        if not self.shape:
            text = "a number"
        else:
            text = f"an array ({', '.join(map(str, self.shape))}{',' * (len(self.shape) == 1)}) of numbers"
        return f"{text} [{self.unit}]" + " or None" * self.may_be_none

    def fits(self, value: object) -> bool:
        """Whether a value is one; NaN passes, the estimator judges it."""
        if value is None:
            return self.may_be_none
        if not self.shape:
            return is_number(value) and has_double(value)
        return isinstance(value, np.ndarray) and value.shape == self.shape and value.dtype.kind in REAL_KINDS


def check_message(message: Any, quantities: Mapping[str, Quantity]) -> None:
    """Refuse a message of which a field has another type, shape or range; its stamps become whole numbers of Python.

    Raises:
        MessageError: names the field, what it must be, and what came.
    """
    name = type(message).__name__
    for field in ("stamp_ns", "arrival_ns"):
        value = getattr(message, field)
        if not is_stamp(value):
            raise MessageError(f"{name}.{field}: must be a whole number of nanoseconds within 64 bits, {got(value)}")
        if value.__class__ is not int:  # those of numpy overflow where ours do not
            object.__setattr__(message, field, int(value))
    if not isinstance(message.sensor, str):
        raise MessageError(f"{name}.sensor: must be a name of the configuration, {got(message.sensor)}")
    for field, quantity in quantities.items():
        value = getattr(message, field)
        if not quantity.fits(value):
            raise MessageError(f"{name}.{field}: must be {quantity}, {got(value)}")


def is_stamp(value: object) -> bool:
    """Whether a value is a time as messages have it."""
    return is_whole(value) and -LIMIT_NS <= int(value) < LIMIT_NS


def array_of(values: Any, shape: tuple[int, ...], name: str, unit: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return an argument as an array of doubles.

    Raises:
        MessageError: it has another shape, or is not made of numbers.
    """
    try:
        found = np.asarray(values)
    except (TypeError, ValueError):
        refuse(values, shape, name, unit)
    if found.shape != shape or not _are_real(found):
        refuse(values, shape, name, unit)
    return np.asarray(found, np.float64)


def _are_real(found: np.ndarray[Any, Any]) -> bool:
    """Whether an array holds numbers that a double can be; beyond 64 bits whole numbers are objects to numpy."""
    if found.dtype.kind != "O":
        return found.dtype.kind in REAL_KINDS
    return all(is_number(one) and has_double(one) for one in found.flat)


def refuse(values: object, shape: tuple[int, ...], name: str, unit: str) -> NoReturn:
    """Raise the error of an argument that is no array of a shape."""
    raise MessageError(f"{name}: must be {Quantity(shape, unit)}, {got(values)}")


def got(value: object) -> str:
    """Return that a value came, in a few words."""
    return f"got {in_words(value)}"


def in_words(value: object) -> str:
    """Return what a value is, in a few words."""
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} of {value.dtype}"
    if isinstance(value, list | tuple):
        return f"a {type(value).__name__} of {len(value)}: {_cut(repr(value[:4]))}"
    if isinstance(value, int) and abs(value) >= LIMIT_NS:
        return "a number of more than 64 bits"
    return f"{_cut(repr(value))} ({type(value).__name__})"


def _cut(text: str) -> str:
    return text if len(text) <= TEXT_CHARACTERS else text[:TEXT_CHARACTERS] + "..."


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a number; a truth value is none."""
    return isinstance(value, NUMBERS) and not isinstance(value, bool)


def has_double(value: float) -> bool:
    """Whether a number is one of a double, infinity among them: whole numbers of Python have no end."""
    try:
        float(value)
    except OverflowError:
        return False
    return True


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a value is a whole number; a truth value is none."""
    return isinstance(value, WHOLE) and not isinstance(value, bool)


def no_message(given: object) -> MessageError:
    """Return the error about something that was given for a message."""
    return MessageError(f"message: must be one of holdfast's messages, {got(given)}")


def optional_number(value: float | None) -> tuple[float, ...]:
    """Return whether a number is there, and the number."""
    return (0.0, 0.0) if value is None else (1.0, value)


def optional_row(matrix: NDArray[np.float64] | None, size: int) -> tuple[float, ...]:
    """Return whether a matrix is there, and its `size` entries."""
    return (0.0,) * (size + 1) if matrix is None else (1.0, *matrix.ravel().tolist())


def optional_matrix(row: Sequence[float], side: int) -> NDArray[np.float64] | None:
    """Return the matrix of which `optional_row` has made a row, or None."""
    return np.array(row[1:]).reshape(side, side) if row[0] else None
