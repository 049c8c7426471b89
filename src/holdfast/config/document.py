"""YAML text as plain data that remembers its lines.

ruamel composes the nodes; the scalars are read here by the core schema of YAML 1.2 (section 10.3.2), so that `1e-4` is
a number, `on` is text, `010` is ten and a date is text, whatever the version of the parser believes.
"""

import json
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, ReusedAnchorWarning, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from holdfast.errors import ConfigError
from holdfast.printable import one_line, quoted

Path = tuple[str | int, ...]
CORE_TAG = "tag:yaml.org,2002:"
MAX_FAULTS = 50
"""Mistakes that are listed."""
MAX_CHARACTERS = 200_000
"""Of a file; an honest one has some thousand. Reading them takes 5 s at most."""
MAX_DEPTH = 50
MAX_NODES = 20_000  # aliases of aliases grow exponentially; an honest configuration has some hundred nodes
CONSTANTS = {word: value for value in (True, False) for word in (f"{value}".lower(), f"{value}", f"{value}".upper())}
NULLS = ("", "~", "null", "Null", "NULL")
INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
PLAIN = re.compile(r"[a-zA-Z0-9_/][a-zA-Z0-9_/.+-]*")
NON_FINITE = re.compile(r"([-+]?)\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


@dataclass(frozen=True, order=True)
class Fault:
    """One mistake in a file: its line, where it is in the tree, and what would be right."""

    line: int
    where: str
    what: str


def path_text(path: Path) -> str:
    """Return a path as people write it: `extrinsics[0].child`."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{quoted(part)}" for part in path)
    return quoted(text.removeprefix("."))


def value_text(value: object, limit: int = 60) -> str:
    """Return a value as it would stand in YAML on one line, cut at `limit` characters."""
    text = one_line(json.dumps(value, ensure_ascii=False))
    text = {"Infinity": ".inf", "-Infinity": "-.inf", "NaN": ".nan"}.get(text, text)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def yaml_text(value: object) -> str:
    """Return a scalar or a list as YAML on one line; text is quoted only where it must be."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(yaml_text, value))}]"
    if isinstance(value, str) and PLAIN.fullmatch(value) and isinstance(scalar(value), str):
        return value
    return one_line(json.dumps(value, ensure_ascii=False))  # JSON's escapes and Python's are YAML's too


def raise_faults(name: str, faults: list[Fault]) -> None:
    """Raise one ConfigError that lists all faults, one line each in the order of the file; none, no error."""
    if faults:
        ordered = sorted(set(faults))
        lines = [f"{name}:{f.line} {f.where}{': ' * bool(f.where)}{f.what}" for f in ordered[:MAX_FAULTS]]
        if len(ordered) > MAX_FAULTS:
            lines.append(f"{name}: and {len(ordered) - MAX_FAULTS} mistakes more")
        raise ConfigError("\n".join(lines))


def scalar(text: str) -> str | float | int | bool | None:
    """Read a plain scalar by the core schema of YAML 1.2."""
    if text in NULLS:
        return None
    if text in CONSTANTS:
        return CONSTANTS[text]
    if INTEGER.fullmatch(text) and len(text) < 300:  # longer ones overflow a float, and Python's int()
        return int(text, 0) if text[:2] in ("0o", "0x") else int(text)
    if NUMBER.fullmatch(text):
        return float(text)
    if found := NON_FINITE.fullmatch(text):
        return float(f"{found[1] or ''}{found[2] or found[3]}")
    return text


def value_at(data: Any, path: Path) -> Any:
    """Return the value at a path in nested maps and lists, or None where there is none."""
    for part in path:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


@dataclass
class Document:
    """A file's plain data; `lines` maps the path of every key and list entry to its line (from 1)."""

    name: str
    data: Any = None
    lines: dict[Path, int] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    refused: set[Path] = field(default_factory=set)  # values with a fault of their own: validation adds no second one
    written: dict[Path, str] = field(default_factory=dict)  # quantities as they stood before conversion

    def line(self, path: Path) -> int:
        """Return the line of the nearest thing on the path that stands in the file."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)

    def at(self, path: Path) -> Any:
        """Return the value at a path, or None where there is none."""
        return value_at(self.data, path)

    def fault(self, path: Path, what: str, line: int | None = None) -> None:
        """Note a mistake at a path."""
        self.faults.append(Fault(line or self.line(path), path_text(path), what))

    def refuse(self, path: Path, what: str) -> None:
        """Note a mistake that makes the value at a path useless for validation."""
        self.fault(path, what)
        self.refused.add(path)

    def is_refused(self, path: Path) -> bool:
        """Return whether the value at a path, or one above it, was refused already."""
        return any(path[:depth] in self.refused for depth in range(len(path) + 1))


def read_document(text: str, name: str) -> Document:
    """Read YAML text.

    Returns:
        The document; duplicate keys, odd keys, tags and broken characters are in its `faults`.

    Raises:
        ConfigError: the text is not YAML, is too large or nested too deeply, is empty, or is not a mapping at the top.
    """
    root = compose(text, name)
    if root is None:
        raise ConfigError(f"{name}:1 is empty: must be `key: value` lines")
    if not isinstance(root, MappingNode):
        kind = "a list" if isinstance(root, SequenceNode) else "a single value"
        raise ConfigError(f"{name}:{root.start_mark.line + 1} has {kind} at the top: must be `key: value` lines")
    document = Document(name)
    document.data = _Reader(document).value(root, ())
    return document


def plain(text: str, name: str) -> dict[str, Any]:
    """Return the data of YAML text that is no configuration, but is as little to be trusted.

    Raises:
        ConfigError: as `read_document`; and for duplicate keys, odd keys, tags and broken characters, one line each.
    """
    document = read_document(text, name)
    raise_faults(name, document.faults)
    data: dict[str, Any] = document.data
    return data


def compose(text: str, name: str) -> Node | None:
    """Return the root node of the only YAML document in the text; every failure becomes a ConfigError of one line."""
    if len(text) > MAX_CHARACTERS:
        raise ConfigError(f"{name}: is too large to be a configuration (allowed: {MAX_CHARACTERS} characters)")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ReusedAnchorWarning)  # YAML 1.2 allows them
            root: Node | None = YAML(typ="safe", pure=True).compose(text)
            return root
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1"
        begun = error.context_mark  # an open bracket is noticed only at the end of the file
        since = f" ({error.context} from line {begun.line + 1})" if mark and begun and begun.line != mark.line else ""
        problem = quoted(f"{error.problem or error.context or 'cannot be read'}{since}")
        raise ConfigError(f"{name}:{place} is not YAML: {problem}") from None
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise ConfigError(f"{name}:{line} is not YAML: control character {error.character!r} is not allowed") from None
    except RecursionError:
        raise ConfigError(f"{name}:1 is nested too deeply") from None
    except (
        YAMLError,
        ValueError,
        OverflowError,
        AttributeError,
        IndexError,
    ) as error:  # ruamel leaks these on odd text
        raise ConfigError(f"{name}:1 is not YAML: {quoted(error)}") from None


class _Reader:
    """Turns nodes into plain data and notes lines and faults in the document."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.nodes = 0

    def value(self, node: Node, path: Path) -> Any:
        """Return the plain value of a node."""
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise ConfigError(f"{self.document.name}:1 has more than {MAX_NODES} values: are aliases nested?")
        if len(path) > MAX_DEPTH:
            line = node.start_mark.line + 1
            raise ConfigError(f"{self.document.name}:{line} is nested too deeply, or an alias contains itself")
        if not str(node.tag).startswith(CORE_TAG):
            self.document.fault(path, f"tag {quoted(node.tag)} is not supported", node.start_mark.line + 1)
        if isinstance(node, MappingNode):
            return {key: self.value(value, (*path, key)) for key, value in self._pairs(node, path)}
        if isinstance(node, SequenceNode):
            return [self._entry(entry, (*path, index)) for index, entry in enumerate(node.value)]
        text = self._text(node, path)
        return text if getattr(node, "style", None) else scalar(text)  # quoted and block scalars are text

    def _pairs(self, node: MappingNode, path: Path) -> Iterator[tuple[str, Node]]:
        """Yield the keys of a mapping with their value nodes; the second of two equal keys is a fault."""
        seen: dict[str, int] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, ScalarNode):
                self.document.fault(path, "has a key that is not a word", line)
                continue
            key = self._text(key_node, path)
            if key in seen:
                self.document.fault((*path, key), f"is given twice (first in line {seen[key]})", line)
                continue
            seen[key] = line
            self.document.lines.setdefault((*path, key), line)
            yield key, value_node

    def _entry(self, node: Node, path: Path) -> Any:
        self.document.lines.setdefault(path, node.start_mark.line + 1)
        return self.value(node, path)

    def _text(self, node: Node, path: Path) -> str:
        text = str(node.value)
        try:
            text.encode()
        except UnicodeEncodeError:  # "\ud800" in double quotes
            self.document.fault(path, "has a broken character (half a surrogate pair)", node.start_mark.line + 1)
            self.document.refused.add(path)
            return ""
        return text
