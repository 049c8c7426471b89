"""Rewrites the text of a configuration of version 0.1; only what must change does, comments and layout stay."""

import warnings
from typing import Any

from ruamel.yaml.nodes import Node

from holdfast.config.document import compose, read_document
from holdfast.config.edit import Edit, edited, pairs_of
from holdfast.config.legacy import SWITCHED_OFF, old_forms
from holdfast.config.load import parse_config
from holdfast.errors import ConfigError


def upgraded(text: str, name: str) -> tuple[str, list[str]]:
    """Return a configuration's text in the form of now, and what was changed, one line each.

    Args:
        text: YAML of either form; nothing is changed in one of the form of now.
        name: of the file, for the messages.

    Raises:
        ConfigError: the text holds mistakes, or is laid out so that it must be rewritten by hand.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that it is of the old form
        before = parse_config(text, name)
    root = pairs_of(compose(text, name))
    edits, changes = [], []
    for section, key, new in old_forms(read_document(text, name).data):
        edits.append(_edit(text, *pairs_of(root[section][1])[key], new))
        changes.append(f"{section}.{key}: now `{new}`")
    text = edited(text, edits)
    try:
        is_same = parse_config(text, name) == before
    except ConfigError:
        is_same = False
    if not is_same:
        raise ConfigError(f"{name}: must be rewritten by hand ({'; '.join(changes)})")
    return text, changes


def _edit(text: str, key: Node, value: Any, new: str) -> Edit:
    """Return the edit that gives a section its kind, a key its new name, or takes the line of a key away."""
    if new == SWITCHED_OFF:
        line = text.rfind("\n", 0, key.start_mark.index) + 1
        return Edit(line, line + len(text[line:].partition("\n")[0]) + 1, "")
    if not new.startswith("kind: "):
        return Edit(key.start_mark.index, key.end_mark.index, new)
    first, _ = value.value[0]
    separator = ", " if value.flow_style else "\n" + " " * first.start_mark.column
    return Edit(first.start_mark.index, first.start_mark.index, new + separator)
