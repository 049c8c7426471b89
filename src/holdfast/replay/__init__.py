"""Replay: the estimator processes a recording in order of arrival, and all of its output is written.

`holdfast.replay` is this package and the function of the public API: it can be called, which `holdfast.api.run` does.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    """A package that is called like the function of its name; it stands above it, and is imported when it is called."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        return import_module("holdfast.api.run").replay(*args, **options)


sys.modules[__name__].__class__ = _Callable
