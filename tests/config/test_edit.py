"""Values are changed in the text of a configuration; what is not meant to change stays, character by character."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.config.document import read_document
from holdfast.config.edit import Change, changed, changed_data
from holdfast.errors import ConfigError

TEXT = """\
# my machine
sensors:
  imu: {kind: imu, topic: /imu}  # the good one
  # the lidar
  lidar:  # on the roof
    kind: odometry  # from kiss
    topic: /lidar

    frame: roof   # odd   spacing
    time_offset_s:
    noise: {value: 3, unit: mm}
extrinsics:
  # measured on Monday
  - {parent: imu, child: roof, translation_m: [1, 2, 3]}
  - parent: imu
    child: g
    rotation_rpy_deg:
      - 1
      - 2  # two
      - 3
"""


def test_a_value_is_replaced_where_it_stands_and_its_comment_stays() -> None:
    text = changed(TEXT, "f", [Change(("sensors", "lidar", "frame"), "mast")])
    assert text == TEXT.replace("frame: roof   # odd", "frame: mast   # odd")


def test_a_new_key_follows_the_first_of_its_section_below_what_the_comment_says() -> None:
    text = changed(TEXT, "f", [Change(("sensors", "lidar", "sigma"), 0.01, "calibrated")])
    assert text == TEXT.replace("# from kiss\n", "# from kiss\n    # calibrated\n    sigma: 0.01\n")


def test_in_a_section_on_one_line_the_comment_stands_above_the_line() -> None:
    text = changed(TEXT, "f", [Change(("sensors", "imu", "noise"), 1e-4, "calibrated")])
    assert text == TEXT.replace("  imu: {kind: imu, ", "  # calibrated\n  imu: {kind: imu, noise: 0.0001, ")


def test_a_list_keeps_its_layout_and_the_comments_in_it() -> None:
    changes = [
        Change(("extrinsics", 1, "rotation_rpy_deg"), [1.5, 2.5, 3.5]),
        Change(("extrinsics", 0, "translation_m"), [1.0, 2.0, 4.0]),
    ]
    text = changed(TEXT, "f", changes)
    assert "      - 1.5\n      - 2.5  # two\n      - 3.5\n" in text
    assert "translation_m: [1.0, 2.0, 4.0]}" in text


def test_an_empty_value_and_one_with_a_unit_are_replaced() -> None:
    changes = [Change(("sensors", "lidar", "time_offset_s"), 0.02), Change(("sensors", "lidar", "noise"), 0.003)]
    text = changed(TEXT, "f", changes)
    assert "    time_offset_s: 0.02\n    noise: 0.003\n" in text


def test_a_section_that_is_an_alias_must_be_changed_by_hand() -> None:
    text = "a: &x {k: 1}\nb: *x\n"
    with pytest.raises(ConfigError, match=r"^f: must be changed by hand \(b\.k: 2\)"):
        changed(text, "f", [Change(("b", "k"), 2)])


NAMES = st.sampled_from(["kind", "a", "b2", "noise", "topic"])
NUMBERS = st.floats(-1e3, 1e3).map(lambda value: round(value, 4))
COMMENTS = st.sampled_from(["", "  # mine", "   #a: {b", " # 'quoted\""])


@st.composite
def files(draw):
    """Sections in block and flow style with comments, blank lines and indentation as people write them."""
    lines, sections = ["# head"], {}
    for number in range(draw(st.integers(1, 4))):
        name, entries = f"s{number}", draw(st.dictionaries(NAMES, NUMBERS | st.lists(NUMBERS, min_size=1), min_size=1))
        sections[name] = list(entries)
        if draw(st.booleans()):
            inner = ", ".join(f"{key}: {value}" for key, value in entries.items())
            lines.append(f"{name}: {{{inner}}}{draw(COMMENTS)}")
        else:
            lines.append(f"{name}:{draw(COMMENTS)}")
            indent = " " * draw(st.integers(1, 4))
            for key, value in entries.items():
                lines += [f"{indent}# about {key}"] * draw(st.integers(0, 1))
                lines.append(f"{indent}{key}: {value}{draw(COMMENTS)}")
                lines += [""] * draw(st.integers(0, 1))
    return "\n".join(lines) + "\n" * draw(st.integers(0, 1)), sections


@given(files(), st.data())
def test_whatever_is_changed_all_lines_of_before_are_there_but_for_the_values(file, data) -> None:
    text, sections = file
    section = data.draw(st.sampled_from(sorted(sections)))
    key = data.draw(st.sampled_from([*sections[section], "new_key"]))
    value = data.draw(NUMBERS | st.lists(NUMBERS, min_size=1))
    change = Change((section, key), value, data.draw(st.sampled_from(["", "calibrated: 1 -> 2"])))
    result = changed(text, "f", [change])
    assert read_document(result, "f").data == changed_data(read_document(text, "f").data, [change])
    before = [line for line in text.splitlines() if f"{key}:" not in line and not line.startswith(f"{section}: ")]
    rest = iter(result.splitlines())
    assert all(line in rest for line in before)  # all of them, in their order
    assert result.count("#") == text.count("#") + bool(change.comment)
