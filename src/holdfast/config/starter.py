"""Writes a first configuration for a recording: with every default commented out, or only what differs from them.

Prose stands behind `# `; a default stands behind a bare `#`, so that deleting the `#` makes it a line of the file.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.config.assignment import described
from holdfast.config.document import yaml_text
from holdfast.config.kinds import KINDS
from holdfast.config.proposal import BASE, Mount, Proposal, SensorProposal, only_what_is_known
from holdfast.config.schema import ROOT, Place, allowed_text, is_optional, type_text
from holdfast.errors import ConfigError
from holdfast.printable import one_line

HEAD = """\
# Holdfast configuration for {recording}, begun by `holdfast config init`.
# Lines that begin with a bare `#` are defaults: delete the `#` to change one. Noise may be given as a datasheet does:
# {{value: 0.3, unit: deg/sqrt(h)}}. Every topic is a GUESS by type and name: read the comments, then measure what is
# marked TODO, and run `holdfast config check` on this file.
"""
SHORT_HEAD = """\
# Holdfast configuration for {recording}: topics are guesses, all else is the default (docs/configuration.md)
"""
PLACEHOLDER = """\
  # PLACEHOLDERS: what is marked TODO sits, as it stands, exactly in its parent with the same axes. That is WRONG on any
  # machine. Measure each translation (within 1 cm) and rotation (within 0.5 deg); give at most one form of rotation;
  # the rotation of a GNSS antenna does not matter.
"""
DECIMALS = 9  # of the numbers of a mount: exact to rounding


def starter_yaml(proposal: Proposal) -> str:
    """Return a commented configuration that loads as it is."""
    joint = proposal.turn_joint
    lines = [HEAD.format(recording=one_line(proposal.recording))]
    for name, child in ROOT.children():
        if name == "sensors":
            lines += ["sensors:", *_sensor_lines(proposal)]
        elif name == "extrinsics":
            lines += _extrinsic_lines(child, proposal)
        elif name == "turn_joint" and joint is not None:
            lines += [f"turn_joint:{_comment(child.about)}", *_joint_lines(child, joint)]
        elif name == "frames" and proposal.base != BASE:
            remarks = {"base": "root of the frames of the chassis"}
            lines += [f"{name}:{_comment(child.about)}", *_filled(child, {"base": proposal.base}, 1, (), remarks)]
        elif child.field is not None and is_optional(child.field):  # it makes no sense before it is filled in
            lines += [f"# {name}:{_comment(child.about)}", *(f"# {line}" for line in _commented(child, 1))]
        elif child.section is None:
            lines += _defaults(ROOT, 0, name)
        else:
            lines += [f"{name}:{_comment(child.about)}", *_defaults(child, 1)]
        lines.append("")
    return "\n".join(lines)


def workable(proposal: Proposal, without_frames: Proposal) -> Proposal:
    """Return the first proposal, or the other one with a warning where the frames of the recording make no machine."""
    from holdfast.config.load import parse_config

    try:
        for one in (proposal, only_what_is_known(proposal)):
            parse_config(minimal_yaml(one))
    except ConfigError as error:
        why = str(error).splitlines()[0].partition(" ")[2]
        warning = f"the frames of the recording make no machine, so they are not used ({why})"
        return replace(without_frames, warnings=(*proposal.warnings, warning))
    return proposal


def minimal_yaml(proposal: Proposal) -> str:
    """Return a configuration that holds only what differs from the defaults, a line per sensor and per mount."""
    lines = [SHORT_HEAD.format(recording=one_line(proposal.recording)) + "sensors:"]
    for sensor in proposal.used:
        told = [f"{key} {text}" for key, text in sensor.measured.remarks.items() if key in sensor.given]
        comment = "; ".join(filter(None, (_todo_of_joint(sensor), *told)))
        lines.append(f"  {sensor.name}: {_flow(sensor.given)}{_comment(comment)}")
    if proposal.mounts:
        lines.append("extrinsics:")
    for mount in proposal.mounts:
        comment = one_line(mount.source) if mount.T is not None else f"TODO measure: {mount.child} in {mount.parent}"
        lines.append(f"  - {_flow(_entry(mount))}{_comment(comment)}")
    if (joint := proposal.turn_joint) is not None:
        comment = one_line(joint.source) if joint.T is not None else "TODO measure where it is"
        lines.append(f"turn_joint: {_flow(_entry(joint))}{_comment(comment)}")
    if proposal.base != BASE:
        lines.append(f"frames: {_flow({'base': proposal.base})}")
    lines += [f"# WARNING: {one_line(warning)}" for warning in proposal.all_warnings]
    return "\n".join(lines) + "\n"


def _flow(section: Mapping[str, Any]) -> str:
    return "{" + ", ".join(f"{key}: {_flow_text(value)}" for key, value in section.items()) + "}"


def _flow_text(value: object) -> str:
    """Return a value within braces, where plain text must not hold a comma or a bracket."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_flow_text, value))}]"
    text = yaml_text(value)
    return text if not isinstance(value, str) or text[0] == '"' or not set(text) & set(",[]{}") else f'"{text}"'


def _entry(mount: Mount) -> dict[str, Any]:
    """Return a mount as an entry of `extrinsics`; a rotation that is none, or does not matter, is left out."""
    entry: dict[str, Any] = {"parent": mount.parent, "child": mount.child, "translation_m": [0.0, 0.0, 0.0]}
    if mount.T is not None:
        entry["translation_m"] = [round(float(value), DECIMALS) + 0.0 for value in mount.T[:3, 3]]
        if mount.turns and not np.allclose(mount.T[:3, :3], np.eye(3), atol=1e-9):
            from gtsam import Rot3  # `holdfast config` need not wait for it where nothing is turned

            q: Any = Rot3(mount.T[:3, :3]).toQuaternion()
            xyzw = np.array((q.x(), q.y(), q.z(), q.w())) * (1.0 if q.w() >= 0.0 else -1.0)
            entry["rotation_quaternion_xyzw"] = [round(float(value), DECIMALS) + 0.0 for value in xyzw]
    return entry


def _angles(mount: Mount) -> str:
    """Return the rotation of a mount as people read it."""
    if mount.T is None:
        return ""
    from gtsam import Rot3

    roll, pitch, yaw = (round(float(value), 3) + 0.0 for value in np.degrees(Rot3(mount.T[:3, :3]).rpy()))
    return f"; roll, pitch, yaw = {roll:g}, {pitch:g}, {yaw:g} deg"


def _sensor_lines(proposal: Proposal) -> Iterator[str]:
    """Yield the section of every sensor, a line per kind without one, and the topics that were left over."""
    for kind, section in KINDS.items():
        sensors = [sensor for sensor in proposal.sensors if sensor.guess.kind == kind]
        for sensor in sensors:
            yield from _section_lines(sensor, _todo(proposal))
        if not sensors:
            has_topic = not is_optional(section.model_fields["topic"])
            yield f"  # {kind}: {'none found' if has_topic else 'has no topic, see docs/configuration.md'}"
    for topic, kinds in proposal.unused:
        yield f"  # not used: {one_line(described(topic))}; could be {', '.join(kinds)}"


def _todo(proposal: Proposal) -> tuple[str, ...]:
    """Return which keys of a sensor must be measured: of a heading its axis, unless both antennas are known."""
    known = {mount.child for mount in proposal.mounts if mount.T is not None}
    antennas = [other for other in proposal.used if other.guess.kind == "gnss" and other.frame in known]
    return () if len(antennas) > 1 else ("mounting_yaw_deg",)


def _todo_of_joint(sensor: SensorProposal) -> str:
    return sensor.measured.remarks.get("joint_name", "") if "joint_name" not in sensor.given else ""


def _section_lines(sensor: SensorProposal, todo: Sequence[str]) -> Iterator[str]:
    guess, section = sensor.guess, Place(sensor.section, None)
    if sensor.why_not:
        yield f"  # {sensor.name}: {one_line(described(guess.topic))}, {one_line(sensor.why_not)}"
        yield f"  # {sensor.name}:"
        yield from (f"  #   {key}: {yaml_text(value)}" for key, value in sensor.given.items())
        return
    yield f"  # {sensor.name}: {one_line(guess.reason)}"
    yield from (f"  # {one_line(note)}" for note in sensor.measured.notes)
    yield from (f"  # WARNING: {one_line(warning)}" for warning in sensor.measured.warnings)
    yield f"  {sensor.name}:{_comment(section.about)}"
    yield from _filled(section, dict(sensor.given), 2, todo, sensor.measured.remarks)


def _extrinsic_lines(extrinsics: Place, proposal: Proposal) -> Iterator[str]:
    """Yield every mount: from the recording, or an identity transform, loudly marked."""
    entry = extrinsics.child(0)
    if not proposal.mounts or entry is None:
        yield f"#extrinsics: []{_comment(extrinsics.about)}"
        return
    yield f"extrinsics:{_comment(entry.about)}"
    yield from (f"  # WARNING: {one_line(warning)}" for warning in proposal.warnings)
    if any(mount.T is None for mount in proposal.mounts):
        yield PLACEHOLDER.rstrip()
    for mount in proposal.mounts:
        given = _entry(mount)
        yield f"  - parent: {yaml_text(mount.parent)}"
        yield f"    child: {yaml_text(mount.child)}"
        if mount.T is None:
            where = f"x forward, y left, z up of {mount.child} in {mount.parent}"
            yield f"    translation_m: [0.0, 0.0, 0.0]  # TODO measure: {one_line(where)}"
        for key, field in entry.children():
            if key in ("parent", "child") or (mount.T is None and key == "translation_m"):
                continue
            if key in given:
                comment = mount.source + (_angles(mount) if key.startswith("rotation") else "")
                yield f"    {key}: {yaml_text(given[key])}{_comment(comment)}"
            else:
                yield f"    #{key}: {_default_text(field)}{_comment(_meaning(field))}"


def _joint_lines(section: Place, joint: Mount) -> Iterator[str]:
    if joint.T is None:
        yield from _filled(section, {"parent": joint.parent, "child": joint.child}, 1, ("translation_m",))
        return
    remarks = {"translation_m": joint.source, "rotation_quaternion_xyzw": joint.source}
    yield from _filled(section, _entry(joint), 1, (), remarks)


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
