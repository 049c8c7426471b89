"""Questions to the model, so that no other file lists its fields: what stands at a path, its unit, type and bounds."""

from collections.abc import Iterator
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from holdfast.config.document import Document, Path
from holdfast.config.model import Config
from holdfast.config.section import OpenUnion

BOUNDS = {Gt: ("gt", ">"), Ge: ("ge", ">="), Lt: ("lt", "<"), Le: ("le", "<=")}


@dataclass(frozen=True)
class Place:
    """What may stand at a path: the type without `Annotated` and `None`, and the field that it belongs to."""

    annotation: Any
    field: FieldInfo | None

    @property
    def section(self) -> type[BaseModel] | None:
        """The model class, where the place is a section."""
        return self.annotation if isinstance(self.annotation, type) and issubclass(self.annotation, BaseModel) else None

    @property
    def unit(self) -> str | None:
        """The unit, as the model gives it."""
        extra = self.field.json_schema_extra if self.field else None
        unit = extra.get("unit") if isinstance(extra, dict) else None
        return unit if isinstance(unit, str) else None

    @property
    def length(self) -> int | None:
        """The number of entries, where it is fixed."""
        arguments = get_args(self.annotation)
        return len(arguments) if get_origin(self.annotation) is tuple and Ellipsis not in arguments else None

    @property
    def about(self) -> str:
        """What the field is, or else what its section is."""
        text = (self.field.description if self.field else None) or (self.section.__doc__ if self.section else None)
        return (text or "").strip().split("\n")[0].rstrip(".")

    @property
    def kinds(self) -> dict[str, type[BaseModel]]:
        """The sections of which it may be one, by the `kind` that names them; empty where there is no choice."""
        is_open = isinstance(self.annotation, type) and issubclass(self.annotation, OpenUnion)
        return dict(self.annotation.kinds) if is_open else {}

    def of(self, value: Any) -> "Place":
        """Return the place as the value makes it: where it has a `kind`, the section of that kind."""
        kind = value.get("kind") if isinstance(value, dict) else None
        section = self.kinds.get(kind) if isinstance(kind, str) else None
        return self if section is None else Place(section, self.field)

    def child(self, part: str | int) -> "Place | None":
        """Return what may stand below: a key of a section, an entry of a list or of a map with names of the user."""
        if get_origin(self.annotation) is dict:
            return Place(get_args(self.annotation)[1], None)
        if self.section is not None:
            field = self.section.model_fields.get(str(part))
            return Place(bare(field.annotation), field) if field else None
        arguments = get_args(self.annotation)
        if get_origin(self.annotation) in (tuple, list) and isinstance(part, int) and arguments:
            entry = arguments[part] if self.length is not None and part < len(arguments) else arguments[0]
            return Place(bare(entry), self.field)
        return None

    def children(self) -> Iterator[tuple[str, "Place"]]:
        """Yield the keys of a section in the model's order; nothing where the place is none."""
        if self.section is not None:
            for name, field in self.section.model_fields.items():
                yield name, Place(bare(field.annotation), field)


ROOT = Place(Config, None)


def place(path: Path, document: Document, root: Place = ROOT) -> Place | None:
    """Return what may stand at a path of a document of the type `root`, or None where nothing may."""
    at: Place | None = root
    for depth, part in enumerate(path, start=1):
        at = at.child(part) if at else None
        at = at.of(document.at(path[:depth])) if at else None
    return at


def bare(annotation: Any) -> Any:
    """Return a type without `Annotated` and `| None`."""
    while True:
        if get_origin(annotation) is Annotated:
            annotation = get_args(annotation)[0]
            continue
        members = [m for m in get_args(annotation) if m is not NoneType]
        if get_origin(annotation) not in (Union, UnionType) or len(members) != 1:
            return annotation
        annotation = members[0]


def is_optional(field: FieldInfo) -> bool:
    """Return whether the field may be null."""
    annotation = field.annotation
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return annotation is NoneType or NoneType in get_args(annotation)


def bounds(field: FieldInfo) -> dict[str, float]:
    """Return the bounds of a field: comparison sign -> number."""
    found = {}
    for constraint in field.metadata:
        if type(constraint) in BOUNDS:
            attribute, sign = BOUNDS[type(constraint)]
            found[sign] = getattr(constraint, attribute)
    return found


def type_text(annotation: Any) -> str:
    """Return a type in plain words."""
    annotation = bare(annotation)
    words = {float: "number", int: "whole number", bool: "true or false", str: "text"}
    if annotation in words:
        return words[annotation]
    arguments = get_args(annotation)
    if get_origin(annotation) is Literal:
        return " or ".join(map(str, arguments))
    if get_origin(annotation) in (tuple, list):
        if Ellipsis in arguments or get_origin(annotation) is list:
            return f"list of {_plural(type_text(arguments[0]))}"
        entry = type_text(arguments[0])
        return f"{len(arguments)} x {entry}" if entry[0].isdigit() else f"{len(arguments)} {_plural(entry)}"
    if get_origin(annotation) in (Union, UnionType):
        return " or ".join(type_text(member) for member in arguments)
    if get_origin(annotation) is dict:
        return f"names, each with a {type_text(arguments[1])}"
    return "section" if Place(annotation, None).section else "value"


def _plural(words: str) -> str:
    if " or " in words:
        return f"values, each {words}"
    return words if words.endswith("s") else f"{words}s"


def bounds_text(at: Place) -> str:
    """Return the bounds of a field: `> 0, <= 1`; empty where there are none."""
    return ", ".join(f"{sign} {bound:g}" for sign, bound in bounds(at.field).items()) if at.field else ""


def allowed_text(at: Place) -> str:
    """Return unit and bounds of a field: `[rad/s/sqrt(Hz)] > 0, <= 1`; empty where there are none."""
    return " ".join(filter(None, (f"[{at.unit}]" if at.unit else "", bounds_text(at))))
