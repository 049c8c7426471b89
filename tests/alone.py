"""Functions of the kernel that only compiled code calls, each alone."""

import numba


def alone(function):
    """Compile such a function once more, so that Python can call it."""
    return numba.njit(error_model="numpy")(function.py_func)
