"""A unit means what its dimension says, and converting there and back changes nothing."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.config.schema import ROOT, Place
from holdfast.config.units import NAMES, USUAL, conversion, fitting, parse_unit


@pytest.mark.parametrize(
    ("unit", "target", "factor"),
    [
        ("deg/sqrt(h)", "rad/s/sqrt(Hz)", math.pi / 180 / 60),
        ("deg/s/sqrt(Hz)", "rad/s/sqrt(Hz)", math.pi / 180),
        ("deg/h/sqrt(Hz)", "rad/s/sqrt(Hz)", math.pi / 180 / 3600),
        ("m/s/sqrt(h)", "m/s^2/sqrt(Hz)", 1 / 60),
        ("ug/sqrt(Hz)", "m/s^2/sqrt(Hz)", 9.80665e-6),
        ("µg/√Hz", "m/s^2/sqrt(Hz)", 9.80665e-6),
        ("deg/s / sqrt(s)", "rad/s^2/sqrt(Hz)", math.pi / 180),
        ("m/s^2/sqrt(s)", "m/s^3/sqrt(Hz)", 1.0),
        ("°/h", "rad/s", math.pi / 180 / 3600),
        ("mg", "m/s^2", 9.80665e-3),
        ("rad", "deg", 180 / math.pi),
        ("%", "1", 0.01),
        ("km/h", "m/s", 1 / 3.6),
        ("sqrt(Hz)*sqrt(Hz)", "Hz", 1.0),
    ],
)
def test_a_conversion_has_its_known_factor(unit: str, target: str, factor: float) -> None:
    assert conversion(unit, target) == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize(
    "unit", ["", "x", "m//s", "/s", "m s", "m^", "m^0", "sqrt()", "sqrt(m", "m/", "sqrt(sqrt(m))", "2"]
)
def test_what_is_no_unit_is_refused_with_the_units_that_are_allowed(unit: str) -> None:
    with pytest.raises(ValueError, match=r"unknown unit .*, allowed are rad/s, deg/s, deg/h$"):
        conversion(unit, "rad/s")


def test_an_angle_is_no_pure_number_and_a_rate_no_frequency() -> None:
    for unit, target in (("rad", "1"), ("rad/s", "Hz"), ("deg/h", "rad/s/sqrt(Hz)"), ("ug", "m/s^2/sqrt(Hz)")):
        with pytest.raises(ValueError, match="unit of another kind"):
            conversion(unit, target)


@given(st.sampled_from(USUAL), st.data())
def test_there_and_back_is_the_same_number(unit: str, data: st.DataObject) -> None:
    other = data.draw(st.sampled_from(fitting(unit)))
    assert conversion(unit, other) * conversion(other, unit) == pytest.approx(1.0, rel=1e-14)


@given(st.lists(st.sampled_from([*NAMES, "sqrt(", ")", "/", "*", "^", "2", " "]), max_size=12).map("".join))
def test_any_text_is_a_unit_or_a_value_error(text: str) -> None:
    try:
        assert parse_unit(text).factor > 0
    except ValueError as error:
        assert "unknown unit" in str(error)


def test_every_unit_in_the_model_is_understood() -> None:
    def units(at: Place) -> list[str]:
        below = [unit for _, child in at.children() for unit in units(child)]
        return below + ([at.unit] if at.unit else [])

    found = units(ROOT)
    assert len(found) > 20
    for unit in found:
        assert parse_unit(unit).factor > 0
