"""Writes a first configuration for a recording, with every default commented out, from the model itself.

Prose stands behind `# `; a default stands behind a bare `#`, so that deleting the `#` makes it a line of the file.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel

from holdfast.config.assignment import Guess, Topic, assign, described
from holdfast.config.document import one_line, yaml_text
from holdfast.config.schema import ROOT, Place, allowed_text, is_optional, place, type_text
from holdfast.errors import RecordingError

HEAD = """\
# Holdfast configuration for {recording}, begun by `holdfast config init`.
# Lines that begin with a bare `#` are defaults: delete the `#` to change one. Noise may be given as a datasheet does:
# {{value: 0.3, unit: deg/sqrt(h)}}. Every topic is a GUESS by type and name: read the comments, then measure what is
# marked TODO, and run `holdfast config check` on this file.
"""
PLACEHOLDER = """\
  # PLACEHOLDERS: as it stands, every sensor sits exactly in the IMU with the same axes. That is WRONG on any machine.
  # TODO measure each translation (within 1 cm) and rotation (within 0.5 deg); give at most one form of rotation;
  # the rotation of a GNSS antenna does not matter.
"""


def starter_yaml(recording: str, topics: Iterable[Topic], types: Mapping[str, Collection[str]]) -> str:
    """Return a commented configuration that loads as it is.

    Args:
        recording: name of the recording, for the messages.
        topics: what it holds.
        types: kind of measurement -> the message types that it can be decoded from.

    Raises:
        RecordingError: no topic can be the IMU.
    """
    topics = list(topics)
    guesses = assign(topics, types)
    if guesses["imu"].topic is None:
        there = one_line(", ".join(described(topic) for topic in topics)) or "nothing"
        raise RecordingError(f"{recording}: no IMU in it, and Holdfast cannot do without one (it has {there})")
    lines = [HEAD.format(recording=one_line(recording))]
    for name, child in ROOT.children():
        if name == "sensors":
            lines += ["sensors:", *_sensor_lines(child, guesses)]
        elif name == "extrinsics":
            lines += _extrinsic_lines(child, _sensor_frames(guesses))
        elif child.field is not None and is_optional(child.field):  # it makes no sense before it is filled in
            lines += [f"# {name}:{_comment(child.about)}", *(f"# {line}" for line in _commented(child, None, 1))]
        elif child.section is None:
            lines += _defaults(ROOT, 0, name)
        else:
            lines += [f"{name}:{_comment(child.about)}", *_defaults(child, 1)]
        lines.append("")
    return "\n".join(lines)


def _sensor_lines(sensors: Place, guesses: Mapping[str, Guess]) -> Iterator[str]:
    """Yield the sections of all sensors; those without a topic are commented out."""
    for name, section in sensors.children():
        guess = guesses.get(name, Guess(None, "never guessed"))
        yield f"  # {name}: {one_line(guess.reason)}"
        yield from (f"  #   could also be {one_line(described(other))}" for other in guess.others)
        if guess.topic is None:
            mark = "#" if name in guesses else "# "
            yield f"  {mark}{name}:{_comment(section.about)}"
            yield from (f"  {mark}{line}" for line in _commented(section, None, 1, {"frame": name}))
            continue
        yield f"  {name}:{_comment(section.about)}"
        live = {"topic": guess.topic, "frame": name}
        for key, field in section.children():
            if key in live:
                yield f"    {key}: {yaml_text(live[key])}{_comment(_meaning(field))}"
            elif key.startswith("mounting_"):
                yield f"    {key}: {_default_text(field)}  # TODO measure: {_meaning(field)}"
            else:
                yield from _defaults(section, 2, key)


def _sensor_frames(guesses: Mapping[str, Guess]) -> list[str]:
    """Return the frames of the guessed sensors whose pose in the IMU must be given: named as the sensors."""
    with_frame = (name for name, guess in guesses.items() if guess.topic and place(("sensors", name, "frame")))
    return [name for name in with_frame if name != "imu"]


def _extrinsic_lines(extrinsics: Place, frames: list[str]) -> Iterator[str]:
    """Yield identity transforms from the IMU to every frame, loudly marked."""
    entry = extrinsics.child(0)
    if not frames or entry is None:
        yield f"#extrinsics: []{_comment(extrinsics.about)}"
        return
    yield f"extrinsics:{_comment(entry.about)}"
    yield PLACEHOLDER.rstrip()
    for frame in frames:
        yield "  - parent: imu"
        yield f"    child: {frame}"
        for key, field in entry.children():
            if key == "translation_m":
                yield f"    {key}: [0.0, 0.0, 0.0]  # TODO measure: x forward, y left, z up of the {frame} in the IMU"
            elif key not in ("parent", "child"):
                yield f"    #{key}: {_default_text(field)}{_comment(_meaning(field))}"


def _defaults(section: Place, depth: int, only: str | None = None) -> Iterator[str]:
    """Yield the commented-out keys, or one of them, of a section that is itself in the file."""
    for line in _commented(section, None, 0, only=only):
        yield f"{'  ' * depth}#{line}"


def _commented(
    section: Place,
    values: BaseModel | None,
    depth: int,
    instead: Mapping[str, str] = MappingProxyType({}),
    only: str | None = None,
) -> Iterator[str]:
    """Yield `key: default  # meaning` for the keys of a section, subsections below their headings.

    Args:
        section: where they stand.
        values: the section whose values are shown; None for the defaults of its fields.
        depth: of the keys' indentation.
        instead: values that are better than the defaults.
        only: the one key that is wanted; None for all.
    """
    for key, field in section.children():
        if only not in (None, key):
            continue
        value = getattr(values, key) if values is not None else _default(field)
        if field.section is not None:
            yield f"{'  ' * depth}{key}:{_comment(field.about)}"
            yield from _commented(field, value, depth + 1)
        else:
            yield f"{'  ' * depth}{key}: {yaml_text(instead.get(key, value))}{_comment(_meaning(field))}"


def _default(field: Place) -> Any:
    """Return a field's default, for a required one something of its type."""
    if field.field is not None and not field.field.is_required():
        return field.field.get_default(call_default_factory=True)
    return {float: 0.0, int: 0, bool: False}.get(field.annotation, "NEEDED")


def _default_text(field: Place) -> str:
    return yaml_text(_default(field))


def _meaning(field: Place) -> str:
    """Return unit, bounds and description: `[rad/s/sqrt(Hz)] > 0, <= 1: white noise`."""
    needed = "needed" if field.field is not None and field.field.is_required() else ""
    rule = ", ".join(filter(None, (needed, allowed_text(field) or type_text(field.annotation))))
    return f"{rule}: {field.about}" if field.about else rule


def _comment(text: str) -> str:
    return f"  # {one_line(text)}" if text else ""
