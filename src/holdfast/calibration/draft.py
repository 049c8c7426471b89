"""A configuration on its way to another one: the text of a file, and what has been changed so far."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, Self

from holdfast.config.document import Path, read_document
from holdfast.config.edit import Change, changed, changed_data
from holdfast.config.load import STARTER, config_of, read_yaml, resolved_yaml
from holdfast.config.model import Config
from holdfast.config.upgrade import upgraded
from holdfast.errors import ConfigError

AnyConfig = Config | Mapping[str, Any] | str | PathLike[str]


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """The text of a configuration, of the form of now, and values that are to be changed in it."""

    name: str
    text: str
    data: Any
    config: Config
    changes: Mapping[Path, Change]

    @classmethod
    def of(cls, given: AnyConfig) -> Self:
        """Begin with a file, with what such a file holds, or with a `Config`.

        Raises:
            ConfigError: it is none of them, or holds mistakes, one line each.
        """
        if isinstance(given, Mapping):
            given = config_of(dict(given), "config")
        if isinstance(given, Config):
            name, text = "config", resolved_yaml(given, given_only=True)
        elif isinstance(given, str | PathLike):
            name, text = str(given), read_yaml(given, STARTER)
        else:
            raise ConfigError(f"config: must be a path, a dict or a Config, not {type(given).__name__}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that it is of an old form, which is upgraded here
            text, _ = upgraded(text, name)
        data = read_document(text, name).data
        return cls(name, text, data, config_of(data, name), {})

    def changed(self, changes: Sequence[Change]) -> Self:
        """Return a draft with further changes; a later one of a key replaces an earlier one."""
        data = changed_data(self.data, changes)
        together = {**self.changes, **{change.path: change for change in changes}}
        return replace(self, data=data, config=config_of(data, self.name), changes=together)

    def written(self) -> str:
        """Return the text with all changes, which reads as the configuration of this draft.

        Raises:
            ConfigError: its layout needs a human.
        """
        return changed(self.text, self.name, list(self.changes.values()))
