"""Writes a first configuration for a recording, with every default commented out, from the model itself.

Prose stands behind `# `; a default stands behind a bare `#`, so that deleting the `#` makes it a line of the file.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from holdfast.config.assignment import Assignment, Guess, Measured, Topic, TopicKind, assign, described, namespace
from holdfast.config.document import one_line, yaml_text
from holdfast.config.kinds import KINDS
from holdfast.config.model import FramesConfig
from holdfast.config.schema import ROOT, Place, allowed_text, is_optional, type_text
from holdfast.config.sensors import GnssVelocityConfig, ImuConfig, MountedConfig, SensorConfig
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
BASE, CABIN = FramesConfig().base, "cabin"
UNMEASURED = Measured()
UNKNOWN_FRAME = {"offset_sigma_m": 1e4, "offset_sigma_deg": 180.0}  # of what is not given in W


def starter_yaml(
    recording: str, topics: Iterable[Topic], kinds: Iterable[TopicKind], measured: Mapping[str, Measured] | None = None
) -> str:
    """Return a commented configuration that loads as it is.

    Args:
        recording: name of the recording, for the messages.
        topics: what it holds.
        kinds: how topics of every kind of measurement are found.
        measured: what the messages of some topics came to, by topic.

    Raises:
        RecordingError: no topic can be the IMU.
    """
    topics = list(topics)
    found = assign(topics, kinds)
    if not any(guess.kind == "imu" for guess in found.guesses):
        there = one_line(", ".join(described(topic) for topic in topics)) or "nothing"
        raise RecordingError(f"{recording}: no IMU in it, and Holdfast cannot do without one (it has {there})")
    has_joint = any(guess.kind == "joint" for guess in found.guesses)
    lines = [HEAD.format(recording=one_line(recording))]
    for name, child in ROOT.children():
        if name == "sensors":
            lines += ["sensors:", *_sensor_lines(found, measured or {})]
        elif name == "extrinsics":
            lines += _extrinsic_lines(child, _mounts(found.guesses, has_joint))
        elif name == "turn_joint" and has_joint:
            lines += [f"turn_joint:{_comment(child.about)}", *_filled(child, {"child": CABIN}, 1, ("translation_m",))]
        elif child.field is not None and is_optional(child.field):  # it makes no sense before it is filled in
            lines += [f"# {name}:{_comment(child.about)}", *(f"# {line}" for line in _commented(child, 1))]
        elif child.section is None:
            lines += _defaults(ROOT, 0, name)
        else:
            lines += [f"{name}:{_comment(child.about)}", *_defaults(child, 1)]
        lines.append("")
    return "\n".join(lines)


def _sensor_lines(found: Assignment, measured: Mapping[str, Measured]) -> Iterator[str]:
    """Yield the section of every sensor, a line per kind without one, and the topics that were left over."""
    antennas = [guess for guess in found.guesses if guess.kind == "gnss"]
    several_imus = sum(KINDS[guess.kind] is ImuConfig for guess in found.guesses) > 1
    for kind, section in KINDS.items():
        guesses = [guess for guess in found.guesses if guess.kind == kind]
        for guess in guesses:
            given = dict(guess.rule.given)
            if section is ImuConfig and several_imus and not guess.rule.spare:
                given["primary"] = True
            if (antenna := antenna_of(guess, antennas)) is not None:
                given["frame"] = antenna.sensor
            yield from _section_lines(
                guess, Place(section, None), given, bool(antennas), measured.get(guess.topic.topic, UNMEASURED)
            )
        if not guesses:
            has_topic = not is_optional(section.model_fields["topic"])
            yield f"  # {kind}: {'none found' if has_topic else 'has no topic, see docs/configuration.md'}"
    for topic, kinds in found.unused:
        yield f"  # not used: {one_line(described(topic))}; could be {', '.join(kinds)}"


def antenna_of(guess: Guess, antennas: Sequence[Guess]) -> Guess | None:
    """Return the antenna whose velocity a topic tells: that of the same receiver, else the only one."""
    if KINDS[guess.kind] is not GnssVelocityConfig:
        return None
    same = [antenna for antenna in antennas if namespace(antenna.topic) == namespace(guess.topic)]
    return next(iter(same), antennas[0] if len(antennas) == 1 else None)


def _section_lines(
    guess: Guess, section: Place, more: dict[str, Any], has_gnss: bool, measured: Measured
) -> Iterator[str]:
    given = {"kind": guess.kind, "topic": guess.topic.topic} | more
    needs_datum = has_gnss and KINDS[guess.kind].model_validate(given).is_in_world()
    offsets = {key: value for key, value in UNKNOWN_FRAME.items() if needs_datum and section.child(key)}
    if guess.rule.spare or (needs_datum and not offsets):
        why = "beside GNSS it needs frames.datum" if needs_datum else "not used beside the primary one"
        yield f"  # {guess.sensor}: {one_line(described(guess.topic))}, {why}"
        yield f"  # {guess.sensor}:"
        yield from (f"  #   {key}: {yaml_text(value)}" for key, value in given.items())
        return
    yield f"  # {guess.sensor}: {one_line(guess.reason)}"
    yield from (f"  # {one_line(note)}" for note in measured.notes)
    yield f"  {guess.sensor}:{_comment(section.about)}"
    given |= offsets | {key: value for key, value in measured.values.items() if section.child(key)}
    yield from _filled(section, given, 2, ("mounting_yaw_deg",), measured.remarks)


def _mounts(guesses: Sequence[Guess], has_joint: bool) -> list[tuple[str, str]]:
    """Return the transforms that must be measured, from parent to child; sensors are in frames of their own name."""
    origin = next(guess.sensor for guess in guesses if guess.kind == "imu")
    mounts = [(origin, CABIN)] if has_joint else []
    antennas = [guess for guess in guesses if guess.kind == "gnss"]
    for guess in guesses:
        section: type[SensorConfig] = KINDS[guess.kind]
        if issubclass(section, MountedConfig) and section is not ImuConfig and antenna_of(guess, antennas) is None:
            below = guess.kind == "base_imu" or (guess.rule.on_chassis and has_joint)
            mounts.append((BASE if below else origin, guess.sensor))
    return mounts


def _extrinsic_lines(extrinsics: Place, mounts: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Yield an identity transform for every mount, loudly marked."""
    entry = extrinsics.child(0)
    if not mounts or entry is None:
        yield f"#extrinsics: []{_comment(extrinsics.about)}"
        return
    yield f"extrinsics:{_comment(entry.about)}"
    yield PLACEHOLDER.rstrip()
    for parent, frame in mounts:
        yield f"  - parent: {parent}"
        yield f"    child: {frame}"
        for key, field in entry.children():
            if key == "translation_m":
                where = f"x forward, y left, z up of {frame} in {parent}"
                yield f"    {key}: [0.0, 0.0, 0.0]  # TODO measure: {where}"
            elif key not in ("parent", "child"):
                yield f"    #{key}: {_default_text(field)}{_comment(_meaning(field))}"


def _filled(
    section: Place,
    given: dict[str, Any],
    depth: int,
    todo: Sequence[str] = (),
    remarks: Mapping[str, str] | None = None,
) -> Iterator[str]:
    """Yield the keys of a section: those that are given, those that must be measured, the others commented out."""
    for key, field in section.children():
        remark = (remarks or {}).get(key, "")
        remark = f"; {one_line(remark)}" if remark else ""
        if key in given:
            comment = "" if key == "kind" else _comment(_meaning(field))
            yield f"{'  ' * depth}{key}: {yaml_text(given[key])}{comment}{remark}"
        elif key in todo:
            yield f"{'  ' * depth}{key}: {_default_text(field)}  # TODO measure: {_meaning(field)}"
        else:
            yield from (line + remark for line in _defaults(section, depth, key))


def _defaults(section: Place, depth: int, only: str | None = None) -> Iterator[str]:
    """Yield the commented-out keys, or one of them, of a section that is itself in the file."""
    for line in _commented(section, 0, only=only):
        yield f"{'  ' * depth}#{line}"


def _commented(section: Place, depth: int, values: object = None, only: str | None = None) -> Iterator[str]:
    """Yield `key: default  # meaning` for the keys of a section, subsections below their headings.

    Args:
        section: where they stand.
        depth: of the keys' indentation.
        values: the section whose values are shown; None for the defaults of its fields.
        only: the one key that is wanted; None for all.
    """
    for key, field in section.children():
        if only not in (None, key):
            continue
        value = _default(field) if values is None else getattr(values, key)
        if field.section is not None:
            yield f"{'  ' * depth}{key}:{_comment(field.about)}"
            yield from _commented(field, depth + 1, value)
        else:
            yield f"{'  ' * depth}{key}: {yaml_text(value)}{_comment(_meaning(field))}"


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
