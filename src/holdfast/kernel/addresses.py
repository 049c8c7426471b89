"""Records by their addresses: a compiled function takes one number instead of an object for each record.

To look at an array object costs a call more than to add a sample to it, where the caches are cold. Whoever gives an
address keeps the array that lies there.
"""

from typing import Any

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]
from numba.core.cgutils import voidptr_t
from numba.extending import intrinsic

from holdfast.kernel.compiling import inner


def _generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
    return builder.inttoptr(arguments[0], voidptr_t)


def _type_pointer(_context: Any, address: Any) -> Any:
    """Return the pointer that a number is."""
    return types.voidptr(address), _generate


_pointer: Any = intrinsic(_type_pointer)


@inner
def records_at(address: int, count: int, dtype: Any) -> Any:
    """Return (count,) records, or words, that lie at an address."""
    return carray(_pointer(address), count, dtype)


@inner
def words_at(address: int, rows: int, width: int) -> Any:
    """Return (rows, width) integers that lie at an address."""
    return carray(_pointer(address), (rows, width), np.int64)


@inner
def floats_at(address: int, rows: int, width: int) -> Any:
    """Return (rows, width) doubles that lie at an address."""
    return carray(_pointer(address), (rows, width), np.float64)
