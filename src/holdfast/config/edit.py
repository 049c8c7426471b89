"""Changes the text of a configuration: values at paths; comments, order and layout of all else stay.

Each change is text in place of characters that the parser has marked; a key that is not there follows the first key of
its section. What was changed is read again and must be what was meant.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from holdfast.config.document import Path, compose, path_text, read_document, yaml_text
from holdfast.errors import ConfigError


class Edit(NamedTuple):
    """Text in place of the characters from `begin` up to `end`."""

    begin: int
    end: int
    text: str


class Change(NamedTuple):
    """A value for a key, and what a comment above it says; without one there is none."""

    path: Path
    value: Any
    comment: str = ""


def edited(text: str, edits: Sequence[Edit]) -> str:
    """Return a text with edits that do not overlap."""
    for edit in sorted(edits, reverse=True):
        text = text[: edit.begin] + edit.text + text[edit.end :]
    return text


def pairs_of(node: Node | None) -> dict[str, tuple[Any, Any]]:
    """Return the nodes of keys and values of a mapping, by key."""
    return {str(key.value): (key, value) for key, value in node.value} if isinstance(node, MappingNode) else {}


def changed(text: str, name: str, changes: Sequence[Change]) -> str:
    """Return the text of a configuration with values changed or added, each with a comment above its line.

    Args:
        text: YAML.
        name: of the file, for the messages.
        changes: at most one for a path; the section around a key must be there.

    Raises:
        ConfigError: the text is laid out so that it must be changed by hand, such as a section that is an alias.
    """
    wanted = changed_data(read_document(text, name).data, changes)
    root = compose(text, name)
    edits = [edit for change in changes for edit in _edits(text, root, change)]
    result = edited(text, _merged(edits))
    try:
        is_as_meant = read_document(result, name).data == wanted
    except ConfigError:
        is_as_meant = False
    if not is_as_meant:
        listed = "; ".join(f"{path_text(change.path)}: {yaml_text(change.value)}" for change in changes)
        raise ConfigError(f"{name}: must be changed by hand ({listed})")
    return result


def changed_data(data: Any, changes: Sequence[Change]) -> Any:
    """Return plain data with values changed or added, as a copy where they differ."""
    for change in changes:
        data = _with(data, change.path, change.value)
    return data


def _with(data: Any, path: Path, value: Any) -> Any:
    if not path:
        return value
    first, *rest = path
    if isinstance(first, int):
        return [_with(one, tuple(rest), value) if k == first else one for k, one in enumerate(data)]
    return data | {first: _with(data.get(first, {}), tuple(rest), value)}


def _edits(text: str, root: Node | None, change: Change) -> Iterator[Edit]:
    parent = root
    for part in change.path[:-1]:
        parent = _child(parent, part)
    pairs = pairs_of(parent)
    key = str(change.path[-1])
    if key in pairs:
        at, old = pairs[key]
        yield from _replacing(text, at, old, change.value)
        yield from _comment_above(text, at, change.comment)
    elif isinstance(parent, MappingNode) and parent.value:
        yield from _adding(text, parent, f"{key}: {yaml_text(change.value)}", change.comment)


def _replacing(text: str, key: Node, old: Any, new: Any) -> Iterator[Edit]:
    """Yield what puts a value in the place of another; of a list each entry on its own, so that its layout stays."""
    begin, end = old.start_mark.index, _end(old)
    if isinstance(old, ScalarNode) and old.style is None and old.value == "":
        colon = text.index(":", key.end_mark.index) + 1
        yield Edit(colon, colon, f" {yaml_text(new)}")
    elif isinstance(old, SequenceNode) and isinstance(new, list | tuple) and len(new) == len(old.value):
        for entry, value in zip(old.value, new, strict=True):
            yield Edit(entry.start_mark.index, _end(entry), yaml_text(value))
    else:
        yield Edit(begin, end, yaml_text(new))


def _comment_above(text: str, key: Node, comment: str) -> Iterator[Edit]:
    if comment:
        line = text.rfind("\n", 0, key.start_mark.index) + 1
        indent = len(text[line:]) - len(text[line:].lstrip(" "))
        yield Edit(line, line, f"{' ' * indent}# {comment}\n")


def _child(node: Node | None, part: str | int) -> Node | None:
    if isinstance(part, int):
        return node.value[part] if isinstance(node, SequenceNode) and part < len(node.value) else None
    found: Node | None = pairs_of(node).get(part, (None, None))[1]
    return found


def _end(node: Any) -> int:
    """Return where the text of a value ends: a block's mark lies behind the comments that follow it."""
    end: int = node.end_mark.index
    if isinstance(node, MappingNode | SequenceNode) and not node.flow_style:
        last = node.value[-1]
        return _end(last[1] if isinstance(last, tuple) else last)
    return end


def _adding(text: str, section: MappingNode, entry: str, comment: str) -> Iterator[Edit]:
    """Yield what adds an entry to a section: below the line of its first key, or before it where that is no line."""
    key, value = section.value[0]
    begin: int = key.start_mark.index
    is_plain = isinstance(value, ScalarNode) and value.style in (None, "'", '"') and value.value != ""
    if section.flow_style:
        yield Edit(_end(value), _end(value), f", {entry}") if is_plain else Edit(begin, begin, f"{entry}, ")
        yield from _comment_above(text, key, comment)
        return
    indent = " " * key.start_mark.column
    lines = [f"# {comment}", entry] if comment else [entry]
    if is_plain and key.start_mark.line == value.start_mark.line == value.end_mark.line:
        end = text.find("\n", value.end_mark.index)
        end = len(text) if end < 0 else end
        yield Edit(end, end, "".join(f"\n{indent}{line}" for line in lines))
    else:
        yield Edit(begin, begin, "".join(f"{line}\n{indent}" for line in lines))


def _merged(edits: Sequence[Edit]) -> list[Edit]:
    """Return edits of which none begins where another does: those that only insert are joined in their order."""
    inserted: dict[int, list[str]] = {}
    for edit in edits:
        if edit.begin == edit.end:
            inserted.setdefault(edit.begin, []).append(edit.text)
    replaced = [edit for edit in edits if edit.begin != edit.end]
    starts = {edit.begin for edit in replaced}
    joined = [Edit(at, at, "".join(texts)) for at, texts in inserted.items() if at not in starts]
    return [edit._replace(text="".join(inserted.get(edit.begin, [])) + edit.text) for edit in replaced] + joined
