"""What pydantic found wrong, in plain words, at a line of the file."""

import json
import re
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from holdfast.config.document import Document, Fault, Path, path_text, value_text
from holdfast.config.kinds import load_plugins
from holdfast.config.schema import Place, place, type_text

COMPARISONS = {
    "greater_than": (">", "gt"),
    "greater_than_equal": (">=", "ge"),
    "less_than": ("<", "lt"),
    "less_than_equal": ("<=", "le"),
}


def note_validation_error(document: Document, root: Place, error: ValidationError) -> None:
    """Add every fault that the validation of a document as `root` found to the document's."""
    for detail in error.errors(include_url=False, include_input=False):
        path = _path_in_file(document, root, detail["loc"], detail["type"])
        if not document.is_refused(path):
            _note(document, root, path, detail)


def faults_in_words(section: type[BaseModel], data: dict[str, Any], error: ValidationError) -> str:
    """Return what is wrong with the data of which a program would make a section, one line per fault."""
    document = Document(section.__name__, json.loads(json.dumps(data, default=_plain)))
    note_validation_error(document, Place(section, None), error)
    faults = dict.fromkeys(f"{fault.where}{': ' * bool(fault.where)}{fault.what}" for fault in document.faults)
    return "\n".join(f"{section.__name__}: {fault}" for fault in faults)


def _plain(value: object) -> object:
    return value.model_dump(mode="json") if isinstance(value, BaseModel) else repr(value)


def _path_in_file(document: Document, root: Place, location: Path, kind: str) -> Path:
    """Return pydantic's location without the parts that are no place in the file: members of a union."""
    path: Path = ()
    at: Place | None = root
    is_tag = False
    for part in location:
        value = document.at(path)
        is_there = part in (value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ())
        if is_there and not is_tag:
            path = (*path, part)
            at = at.child(part) if at else None
        is_tag = at is not None and bool(at.kinds) and not is_tag
        at = at.of(document.at(path)) if at and not is_tag else at
    return (*path, location[-1]) if kind == "missing" else path


def _note(document: Document, root: Place, path: Path, detail: ErrorDetails) -> None:
    kind, context = detail["type"], detail.get("ctx", {})
    at = place(path, document, root)
    if kind == "missing" and isinstance(path[-1], int):  # a short tuple is reported entry by entry
        kind, path, at = "too_short", path[:-1], place(path[:-1], document, root)
    if kind == "missing":
        document.fault(path, missing_text(at))
    elif kind == "extra_forbidden":
        document.fault(path, unknown_key_text(str(path[-1]), place(path[:-1], document, root) or root))
    elif kind.startswith("union_tag") and at is not None:
        document.fault(path, kind_fault(at, document.at(path)) or detail["msg"])
    elif kind == "value_error":
        _note_validator(document, root, path, str(context.get("error", detail["msg"])))
    else:
        value = document.written.get(path) or value_text(document.at(path))
        text = _rule_text(kind, at, detail["msg"], context) + _hint(kind, at, document.at(path))
        document.faults.append(Fault(document.line(path), f"{path_text(path)} = {value}", text))


def kind_fault(at: Place, value: object) -> str | None:
    """Return what is wrong with the `kind` of a section that must name one of several; None if nothing is."""
    kind = value.get("kind") if isinstance(value, dict) else None
    if isinstance(kind, str) and kind not in at.kinds:
        load_plugins()
    allowed = ", ".join(at.kinds)
    if not isinstance(value, dict):
        return f"must be a section with `kind:` and more (allowed: {allowed})"
    if "kind" not in value:
        return f"kind: missing, must be one of {allowed}"
    if isinstance(kind, str) and kind in at.kinds:
        return None
    near = get_close_matches(str(kind).lower(), at.kinds, n=1, cutoff=0.6)
    guess = f"did you mean {near[0]}? " if near else ""
    return f"kind = {value_text(kind)}: {guess}must be one of {allowed}"


def missing_text(at: Place | None) -> str:
    """Return the fault of a required key that is not there."""
    if at is None:
        return "missing"
    about = f": {at.about}" if at.about else ""
    unit = f" [{at.unit}]" if at.unit else ""
    return f"missing, must be {_with_article(type_text(at.annotation))}{unit}{about}"


def unknown_key_text(key: str, parent: Place) -> str:
    """Return the fault of a key that the section does not have."""
    allowed = [name for name, _ in parent.children()]
    near = get_close_matches(key.lower(), allowed, n=1, cutoff=0.7)
    if near:
        return f"unknown key, did you mean {near[0]}?"
    return f"unknown key, allowed are {', '.join(allowed)}"


def _rule_text(kind: str, at: Place | None, message: str, context: dict[str, Any]) -> str:
    """Return the rule that a value broke, with the unit where it has one."""
    unit = f" [{at.unit}]" if at and at.unit else ""
    if kind in COMPARISONS:
        sign, name = COMPARISONS[kind]
        return f"must be {sign} {context[name]:g}{unit}"
    if kind == "finite_number":
        return f"must be finite{unit}"
    if kind == "literal_error" and at:
        return f"must be one of {', '.join(map(str, get_args(at.annotation)))}"
    if kind in ("too_short", "too_long") and at and at.length:
        return f"must have {at.length} entries{unit}"
    if kind == "string_too_short":
        return "must not be empty"
    if kind in ("model_type", "model_attributes_type"):
        return "must be a section with `key: value` lines"
    if kind.endswith("_type") and at:
        return f"must be {_with_article(type_text(at.annotation))}{unit}"
    return message[0].lower() + message[1:]


def _hint(kind: str, at: Place | None, value: object) -> str:
    """Return what to do about a frequent slip: a number in quotes, a number where text is meant."""
    if kind == "float_type" and isinstance(value, str):
        try:
            float(value)
        except ValueError:
            return ""
        return ": write it without quotes"
    if kind == "string_type" and value is not None and not isinstance(value, dict | list):
        return ": put it in quotes"
    if kind == "bool_type" and at and str(value).lower() in ("on", "off", "yes", "no"):
        return ": YAML 1.2 knows only true and false"
    return ""


def _with_article(words: str) -> str:
    if words[0].isdigit():
        return f"a list of {words}"
    return words if words.startswith(("text", "true", "names")) or " or " in words else f"a {words}"


def _note_validator(document: Document, root: Place, path: Path, message: str) -> None:
    """Note what a validator of the model raised, one fault per line.

    A line may begin with a path below the validator's section (`sensors.lidar.frame: ...`); else the first key of the
    section that it mentions gives the place in the file.
    """
    for text in message.splitlines():
        found = re.match(r"([\w.]+): ", text)
        named: Path = (*path, *found[1].split(".")) if found else ()
        if found and place(named, document, root) is not None:
            document.fault(named, text[found.end() :])
            continue
        keys = document.at(path)
        mentioned = next((word for word in re.findall(r"\w+", text) if isinstance(keys, dict) and word in keys), None)
        document.fault(path, text, document.line((*path, mentioned) if mentioned else path))
