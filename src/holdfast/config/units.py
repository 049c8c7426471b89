"""Units as text (`deg/sqrt(h)`), and conversion between those of the same dimension.

A unit is a product of names with powers; `sqrt(...)` halves the powers. So every datasheet unit is understood that has
the dimension of the field, and none that has not: `deg/sqrt(h)` is `rad/s/sqrt(Hz)` times pi / 180 / 60.
"""

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

from holdfast.geometry.earth import STANDARD_GRAVITY_M_S2
from holdfast.printable import quoted

# name -> (factor to SI, {base dimension: power}); an angle is a dimension, so that rad never passes for a pure number
NAMES: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "%": (0.01, {}),
    "ppm": (1e-6, {}),
    "sigma": (1.0, {"sigma": 1}),
    "m": (1.0, {"m": 1}),
    "mm": (1e-3, {"m": 1}),
    "cm": (1e-2, {"m": 1}),
    "km": (1e3, {"m": 1}),
    "s": (1.0, {"s": 1}),
    "ms": (1e-3, {"s": 1}),
    "us": (1e-6, {"s": 1}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "hr": (3600.0, {"s": 1}),
    "Hz": (1.0, {"s": -1}),
    "rad": (1.0, {"rad": 1}),
    "mrad": (1e-3, {"rad": 1}),
    "deg": (math.pi / 180.0, {"rad": 1}),
    "g": (STANDARD_GRAVITY_M_S2, {"m": 1, "s": -2}),
    "mg": (1e-3 * STANDARD_GRAVITY_M_S2, {"m": 1, "s": -2}),
    "ug": (1e-6 * STANDARD_GRAVITY_M_S2, {"m": 1, "s": -2}),
}

# what datasheets and people write; an error message lists those of the right dimension
USUAL = (
    *("m", "mm", "cm", "km", "s", "ms", "us", "rad", "mrad", "deg", "1", "%", "ppm"),
    *("m/s", "km/h", "mm/s", "rad/s", "deg/s", "deg/h", "m/s^2", "g", "mg", "ug"),
    *("m/s^2/sqrt(Hz)", "mg/sqrt(Hz)", "ug/sqrt(Hz)", "m/s/sqrt(s)", "m/s/sqrt(h)"),
    *("rad/s/sqrt(Hz)", "deg/s/sqrt(Hz)", "deg/h/sqrt(Hz)", "deg/sqrt(s)", "deg/sqrt(h)"),
    *("m/s^3/sqrt(Hz)", "m/s^2/sqrt(s)", "mg/sqrt(s)", "ug/sqrt(s)", "mg/sqrt(h)", "ug/sqrt(h)"),
    *(
        "rad/s^2/sqrt(Hz)",
        "rad/s/sqrt(s)",
        "deg/s/sqrt(s)",
        "deg/s/sqrt(h)",
        "deg/h/sqrt(h)",
        "m/sqrt(s)",
        "mm/sqrt(s)",
    ),
)
FACTOR = re.compile(r"([*/]?)(?:sqrt\(([^()]+)\)|([a-zA-Z%]+|1))(?:\^([1-9]))?")


@dataclass(frozen=True)
class Unit:
    """A factor to SI and the powers of the base dimensions, without zeros."""

    factor: float
    powers: frozenset[tuple[str, Fraction]]


@cache
def parse_unit(text: str) -> Unit:
    """Read a unit such as `m/s^2/sqrt(Hz)`.

    Raises:
        ValueError: it is not made of known names, `*`, `/`, `^` and `sqrt()`.
    """
    text = (
        re.sub(r"\s*([*/^()])\s*", r"\1", text.strip())
        .replace("µ", "u")
        .replace("μ", "u")
        .replace("°", "deg")
        .replace("√Hz", "sqrt(Hz)")
    )
    factor, powers, at = 1.0, dict[str, Fraction](), 0
    while at < len(text) or at == 0:
        part = FACTOR.match(text, at)
        if part is None or bool(part[1]) != (at > 0) or (part[3] and part[3] not in NAMES):
            raise ValueError(f"unknown unit {quoted(text)!r}")
        inner = parse_unit(part[2]) if part[2] else _named(part[3])
        power = Fraction(int(part[4] or 1), 2 if part[2] else 1) * (-1 if part[1] == "/" else 1)
        factor *= inner.factor ** float(power)
        for name, inner_power in inner.powers:
            powers[name] = powers.get(name, Fraction(0)) + power * inner_power
        at = part.end()
    return Unit(factor, frozenset((name, power) for name, power in powers.items() if power))


def conversion(unit: str, target: str) -> float:
    """Return the factor that turns a number in `unit` into one in `target`.

    Raises:
        ValueError: the unit is unknown or of another dimension; the text names the usual ones that fit.
    """
    into = parse_unit(target)
    try:
        given = parse_unit(unit)
    except ValueError:
        given = None
    if given is None or given.powers != into.powers:
        problem = "unknown unit" if given is None else "unit of another kind"
        raise ValueError(f"{problem} {quoted(unit)!r}, allowed are {', '.join(fitting(target))}")
    return given.factor / into.factor


def fitting(target: str) -> list[str]:
    """Return the usual units of the target's dimension, the target first."""
    powers = parse_unit(target).powers
    return [target, *(unit for unit in USUAL if unit != target and parse_unit(unit).powers == powers)]


def _named(name: str) -> Unit:
    factor, powers = NAMES[name]
    return Unit(factor, frozenset((base, Fraction(power)) for base, power in powers.items()))
