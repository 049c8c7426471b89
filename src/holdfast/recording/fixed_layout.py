"""Where the fields of a CDR message lie, so that those that a decoder needs are read without decoding the rest.

Where they lie depends only on the lengths of the strings and sequences before them, which as a rule never change on a
topic: the first message tells them, and a message with others is left to the general decoder.
"""

import struct
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

from rosbags.interfaces import Nodetype

ENCAPSULATION = b"\x00\x01"  # little endian; two more bytes follow
LENGTH = struct.Struct("<I")
FORMATS = {
    "bool": "?", "byte": "B", "char": "b", "octet": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip


class FixedLayout:
    """The layout of the messages of one topic that are like a given one.

    Args:
        definitions: fields of every type, as rosbags parses them.
        type_name: of the message.
        fields: what is wanted: paths to numbers, to arrays or sequences of numbers, or to sequences of strings.
        raw: a message that has been decoded.

    Raises:
        ValueError, KeyError: the layout cannot be told.
    """

    def __init__(self, definitions: Mapping[str, Any], type_name: str, fields: Sequence[str], raw: bytes) -> None:
        if raw[:2] != ENCAPSULATION:
            raise ValueError("not CDR, little endian")
        self._definitions, self._raw = definitions, raw
        self._wanted = frozenset(fields)
        self._at = 4
        self._format = ["<4x"]
        self._values = 0
        self._lengths: list[int] = []  # which values are lengths
        self._places: dict[str, int | slice] = {}
        self._walk_type(type_name, "")
        self._format.append(f"{len(raw) - self._at}x")
        self._struct = struct.Struct("".join(self._format))
        self._strings = frozenset(k for k, name in enumerate(fields) if getattr(self._places[name], "step", None))
        self._pick, self._pick_lengths = (
            itemgetter(*(self._places[name] for name in fields)),
            itemgetter(*self._lengths),
        )
        self._expected = self._pick_lengths(self._struct.unpack(raw))

    def read(self, raw: bytes) -> tuple[Any, ...] | None:
        """Return the wanted fields, arrays and sequences as tuples; None if the message is laid out otherwise."""
        if len(raw) != self._struct.size or raw[:2] != ENCAPSULATION:
            return None
        values = self._struct.unpack(raw)
        if self._pick_lengths(values) != self._expected:
            return None
        found: tuple[Any, ...] = self._pick(values)
        if self._strings:
            return tuple(
                tuple(text[:-1].decode() for text in one) if k in self._strings else one for k, one in enumerate(found)
            )
        return found

    def _walk_type(self, type_name: str, path: str) -> None:
        for name, (kind, detail) in self._definitions[type_name][1]:
            self._walk(kind, detail, f"{path}.{name}" if path else name)

    def _walk(self, kind: Nodetype, detail: Any, path: str) -> None:
        if kind == Nodetype.NAME:
            self._walk_type(detail, path)
        elif kind == Nodetype.BASE:
            self._take(detail[0], 1, path)
        else:
            (of_kind, of_detail), count = detail
            if kind == Nodetype.SEQUENCE:
                count = self._length()
            if of_kind == Nodetype.BASE:
                self._take(of_detail[0], count, path, many=True)
            else:
                for k in range(count):
                    self._walk(of_kind, of_detail, f"{path}.{k}")

    def _take(self, base: str, count: int, path: str, *, many: bool = False) -> None:
        """Pass over so many values of a type, and note where they are if they are wanted."""
        first = self._values
        if base == "string":
            for _ in range(count):
                size = self._length()
                self._add(f"{size}s", size, 1)
            self._places[path] = slice(first + 1, self._values, 2)  # each follows its length
            return
        code = FORMATS[base]
        size = struct.calcsize(code)
        if count:
            self._align(size)
        if path in self._wanted:
            self._add(f"{count}{code}", count * size, count)
            self._places[path] = slice(first, self._values) if many else first
        else:
            self._add(f"{count * size}x", count * size, 0)

    def _length(self) -> int:
        self._align(4)
        length: int = LENGTH.unpack_from(self._raw, self._at)[0]
        self._lengths.append(self._values)
        self._add("I", 4, 1)
        return length

    def _align(self, size: int) -> None:
        padding = -(self._at - 4) % size
        self._add(f"{padding}x", padding, 0)

    def _add(self, code: str, size: int, values: int) -> None:
        self._format.append(code)
        self._at += size
        self._values += values
        if self._at > len(self._raw):
            raise ValueError("the message ends too early")
