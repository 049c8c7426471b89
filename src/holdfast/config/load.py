"""Reading the configuration: all faults at once, each with its line, its place and what would be right."""

import json
import warnings
from collections.abc import Iterator
from os import PathLike
from pathlib import Path as FilePath
from typing import Any, TypeVar, get_origin

import numpy as np
from pydantic import BaseModel, ValidationError

from holdfast.config.document import MAX_CHARACTERS, Document, Path, raise_faults, read_document, value_text, yaml_text
from holdfast.config.faults import kind_fault, note_validation_error
from holdfast.config.legacy import modernised, old_forms
from holdfast.config.model import Config
from holdfast.config.presets import with_preset
from holdfast.config.schema import Place, is_optional
from holdfast.config.units import conversion
from holdfast.errors import ConfigError
from holdfast.measured_fields import got
from holdfast.printable import quoted

Model = TypeVar("Model", bound=BaseModel)
STARTER = "`holdfast config init RECORDING` starts one"


def load_config(path: str | PathLike[str]) -> Config:
    """Read a configuration file (YAML 1.2, UTF-8).

    Raises:
        ConfigError: it cannot be read, or holds mistakes; the text has one line per mistake.
    """
    return parse_config(read_yaml(path, STARTER), str(path))


def parse_config(text: str, name: str = "config") -> Config:
    """Read a configuration from YAML text; `name` stands for the file in the messages.

    Raises:
        ConfigError: the text holds mistakes, one line each.
    """
    document = read_document(text, name)
    old = _modernise(document)
    document.data = with_preset(document.data)
    config = validate(document, Config)
    if old:
        warnings.warn(f"{name}: is of the old form ({old}); `holdfast config upgrade {name}` rewrites it", stacklevel=2)
    return config


def config_of(data: dict[str, Any], name: str) -> Config:
    """Return the configuration that plain data make, NumPy's numbers and arrays among them.

    Args:
        data: as a file holds them.
        name: stands for the file in the messages.

    Raises:
        ConfigError: the data hold mistakes, one line each.
    """
    try:
        document = Document(name, json.loads(json.dumps(data, default=_plain)))
    except (TypeError, ValueError, RecursionError) as error:  # a value or a key of another type, a dict in itself
        raise ConfigError(f"{name}: must hold text, numbers, lists and dicts alone ({error})") from None
    _modernise(document)
    document.data = with_preset(document.data)
    return validate(document, Config)


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(got(value))


def _modernise(document: Document) -> str:
    """Bring the data into the form of now, in place; return an example of what was of an old form, or nothing."""
    if not isinstance(document.data, dict):
        return ""
    old = [f"{section}.{key}: now `{new}`" for section, key, new in old_forms(document.data)]
    if old:
        document.data = modernised(document.data)
    return old[0] if old else ""


def read_yaml(path: str | PathLike[str], remedy: str) -> str:
    """Return the text of a file; `remedy` ends the error where there is none.

    Raises:
        ConfigError: it cannot be read.
    """
    if not isinstance(path, str | PathLike):
        raise ConfigError(f"the file of a configuration: must be a path, not {type(path).__name__}")
    try:
        with FilePath(path).open(encoding="utf-8-sig") as file:
            return file.read(MAX_CHARACTERS + 1)  # one more is refused where it is read
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text (byte {error.start}): must be a YAML file") from None
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file ({remedy})") from None
    except (OSError, ValueError) as error:  # a NUL in the path is a ValueError
        reason = "is a folder" if isinstance(error, IsADirectoryError) else getattr(error, "strerror", None) or error
        raise ConfigError(f"{path}: {reason}: must be a YAML file") from None


def validate(document: Document, model: type[Model]) -> Model:
    """Return a document's data as a model of sections.

    Raises:
        ConfigError: the data break the model's rules, one line each.
    """
    root = Place(model, None)
    document.data = _prepare(document, root, document.data, ())
    try:
        # the JSON mode of pydantic's strict validation takes lists for tuples and integers for floats, and nothing else
        with np.errstate(over="ignore", invalid="ignore"):  # matrices of 1e200 are refused, without noise on the screen
            found = model.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        note_validation_error(document, root, error)
        found = None
    raise_faults(document.name, document.faults)
    if found is None:
        raise ConfigError(f"{document.name}:1 cannot be read")
    return found


def resolved_yaml(section: BaseModel, *, given_only: bool = False) -> str:
    """Return a configuration as YAML; reading it again gives an equal one.

    Args:
        section: the configuration, or another model of sections.
        given_only: leave out what nobody set, so that the defaults of the day apply.
    """
    return "\n".join(_yaml_lines(section.model_dump(mode="json", exclude_unset=given_only))) + "\n"


def _yaml_lines(section: dict[str, Any]) -> Iterator[str]:
    """Yield a section in block style; lists of plain values stay on one line."""
    for key, value in section.items():
        if isinstance(value, dict) and value:
            yield f"{key}:"
            yield from (f"  {line}" for line in _yaml_lines(value))
        elif isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value):
            yield f"{key}:"
            for entry in value:
                first, *rest = _yaml_lines(entry)
                yield from (f"  - {first}", *(f"    {line}" for line in rest))
        else:
            yield f"{key}: {yaml_text(value)}"


def _prepare(document: Document, at: Place, value: Any, path: Path) -> Any:
    """Return the value with every `{value, unit}` in the field's unit, and bare section headings as empty sections."""
    if at.kinds:
        fault = kind_fault(at, value)
        if fault:
            document.refuse(path, fault)
            return value
        at = at.of(value)
    if get_origin(at.annotation) is dict and isinstance(value, dict):
        entries = ((name, entry, at.child(name)) for name, entry in value.items())
        return {name: _prepare(document, child, entry, (*path, name)) for name, entry, child in entries if child}
    if at.section is not None:
        if value is None and (at.field is None or not is_optional(at.field)):
            value = {}  # a heading under which every line is commented out
        if not isinstance(value, dict):
            return value
        known = ((key, entry, at.child(key)) for key, entry in (_defaults(at) | value).items())
        return {key: _prepare(document, child, entry, (*path, key)) if child else entry for key, entry, child in known}
    if isinstance(value, dict) and at.unit is not None:
        return _converted(document, at.unit, value, path)
    if isinstance(value, list):
        children = [at.child(index) for index in range(len(value))]
        return [
            _prepare(document, child, entry, (*path, index)) if child else entry
            for index, (child, entry) in enumerate(zip(children, value, strict=True))
        ]
    return value


def _defaults(at: Place) -> dict[str, Any]:
    """Return what a section that is given in part keeps: the field's default may differ from the section's own."""
    default = at.field.get_default() if at.field else None
    return default.model_dump(mode="json", exclude_unset=True) if isinstance(default, BaseModel) else {}


def _converted(document: Document, target: str, given: dict[str, Any], path: Path) -> Any:
    """Return the number, or the list of numbers, of `{value: 0.3, unit: deg/sqrt(h)}` in the field's unit."""
    value, unit = given.get("value"), given.get("unit")
    numbers: list[Any] = value if isinstance(value, list) else [value]
    if set(given) != {"value", "unit"} or not isinstance(unit, str):
        document.refuse(path, f"must be a number [{target}] or {{value: number, unit: {target}}}")
        return None
    if not all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
        document.refuse((*path, "value"), f"must be a number [{quoted(unit)}], not {value_text(value)}")
        document.refused.add(path)
        return None
    try:
        factor = conversion(unit, target)
    except ValueError as error:
        document.refuse((*path, "unit"), str(error))
        document.refused.add(path)
        return None
    converted = [number * factor for number in numbers]
    document.written[path] = f"{value_text(value)} {unit}"
    return converted if isinstance(value, list) else converted[0]
