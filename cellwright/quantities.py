"""Read quantities as people write them ("182 mm", "31 deg", "0.01 /mm^2") into SI numbers, and write them back.

A number and its unit are parsed with pint against a small registry of our own, in which the angle is a dimension:
"2 Hz" is no angular speed and "31" is no angle. A bare number is accepted only where the quantity has no unit.
Importing this module is cheap; pint is imported with the first quantity.
"""

from __future__ import annotations

import difflib
import functools
import math
import re
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from cellwright.errors import InvalidInputError, listed

_DEFINITIONS = """
micro- = 1e-6 = µ- = μ- = u-
milli- = 1e-3 = m-
kilo- = 1e3 = k-
meter = [length] = m = metre
centimeter = 0.01 * meter = cm = centimetre
decimeter = 0.1 * meter = dm = decimetre
inch = 0.0254 * meter = in = inches
foot = 0.3048 * meter = ft = feet
thou = 0.0000254 * meter = mil
second = [time] = s = sec
minute = 60 * second = min
hour = 3600 * second = h
radian = [angle] = rad
degree = 0.017453292519943295 * radian = deg = °
turn = 6.283185307179586 * radian = rev = revolution
rpm = turn / minute
hertz = 1 / second = Hz
kilogram = [mass] = kg
gram = 0.001 * kilogram = g
newton = kilogram * meter / second ** 2 = N
percent = 0.01
point = 1 = points
"""
"""Prefixes and units that a cell file may use; an angle is no pure number here, unlike in SI."""

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*", re.DOTALL)
_TERM = r"(?:[A-Za-z\u00b5\u03bc]{1,20}|°|%)(?:(?:\^|\*\*)-?\d|[²³])?"
_UNIT = re.compile(rf"(?:1?\s*/\s*)?{_TERM}(?:\s*[*/ ]\s*{_TERM}){{0,4}}")
_DECIMAL_COMMA = re.compile(r"\s*([+-]?\d+),(\d+)\s*([^\d,]*.*)")


@dataclass(frozen=True)
class Dimension:
    """What a quantity measures.

    Attributes:
        name: Noun with its article, for messages: "a length".
        si: SI unit, empty for pure numbers.
        usual: Unit in which people write it, used by messages and by `format_quantity`.
        also: Other accepted units, for messages.
    """

    name: str
    si: str
    usual: str
    also: tuple[str, ...] = ()


LENGTH = Dimension("a length", "m", "mm", ("um", "cm", "m", "in"))
FINE_LENGTH = Dimension("a length", "m", "um", ("mm", "in"))
ANGLE = Dimension("an angle", "rad", "deg", ("rad",))
TIME = Dimension("a time", "s", "s", ("ms", "min"))
SPEED = Dimension("a speed", "m/s", "mm/s", ("m/s", "m/min"))
ACCELERATION = Dimension("an acceleration", "m/s^2", "m/s^2", ("mm/s^2",))
ANGULAR_SPEED = Dimension("an angular speed", "rad/s", "deg/s", ("rad/s", "rpm"))
ANGULAR_ACCELERATION = Dimension("an angular acceleration", "rad/s^2", "deg/s^2", ("rad/s^2",))
FREQUENCY = Dimension("a frequency", "Hz", "Hz", ("kHz",))
MASS = Dimension("a mass", "kg", "kg", ("g",))
TIME_WEIGHT = Dimension("a weight of time", "1/s", "/s")
TORQUE_WEIGHT = Dimension("a weight of squared torque", "1/N^2/m^2/s", "/N^2/m^2/s")
SPEED_WEIGHT = Dimension("a weight of squared speed", "s/rad^2", "s/rad^2", ("s/deg^2",))
AREAL_DENSITY = Dimension("a density on a surface", "1/m^2", "/mm^2", ("/cm^2", "/m^2"))
SHARE = Dimension("a share", "", "%")
NUMBER = Dimension("a pure number", "", "")


def parse_quantity(value: object, dimension: Dimension) -> float:
    """Return the SI value of a quantity as written: text with a unit, or a number where there is no unit.

    The conversion is decimal, so the result is the float nearest to the quantity: "100 um" is 1e-4.

    Raises:
        InvalidInputError: If the text is no quantity, its unit is missing, unknown or of another dimension,
            or the number is not finite.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        shown = "nothing" if value is None else repr(value)
        raise InvalidInputError(f"{shown} is not {dimension.name}: write a number{_with_unit(dimension)}")
    number, unit = _split(value, dimension)
    if not unit and dimension.si:
        raise InvalidInputError(
            f"{value!r} has no unit but {dimension.name} needs one: write {number}{_spaced(dimension.usual)}"
        )
    result = float(number * _si_factor(unit, value, dimension) if unit else number)
    if not math.isfinite(result):
        raise InvalidInputError(f"{value!r} is not finite: write a number{_with_unit(dimension)}")
    return result


def format_quantity(value: float, dimension: Dimension, digits: int = 6) -> str:
    """Write an SI value in the usual unit of its dimension, with up to ``digits`` significant digits.

    >>> format_quantity(0.182, LENGTH)
    '182 mm'
    """
    factor = float(_si_factor(dimension.usual, value, dimension)) if dimension.usual else 1.0
    text = f"{value / factor:.{digits}g}"
    return f"{'0' if text == '-0' else text}{_spaced(dimension.usual)}"


def _split(value: str | float, dimension: Dimension) -> tuple[Decimal, str]:
    text = str(value)
    comma = _DECIMAL_COMMA.fullmatch(text)
    if comma is not None:
        unit = _spaced(comma[3].strip())
        thousands = f"{comma[1]}{comma[2]}{unit} or " if len(comma[2]) == 3 else ""
        raise InvalidInputError(f"{value!r} has a comma: write {thousands}{comma[1]}.{comma[2]}{unit}")
    match = _QUANTITY.fullmatch(text)
    if match is None:
        finite = isinstance(value, str) or math.isfinite(value)
        fault = f"not {dimension.name}" if finite else "not finite"
        raise InvalidInputError(f"{value!r} is {fault}: write a number{_with_unit(dimension)}")
    return Decimal(match[1]), match[2]


def _si_factor(unit: str, value: object, dimension: Dimension) -> Decimal:
    import pint

    if not _UNIT.fullmatch(unit):
        raise InvalidInputError(f"{value!r} has the unreadable unit {unit!r}: write {_units(dimension)}")
    expression = unit.replace("%", "percent").replace("²", "^2").replace("³", "^3")
    registry = _registry()
    try:
        measured = registry.Quantity(
            Decimal(1), registry.parse_units(f"1{expression}" if unit[0] == "/" else expression)
        )
        return Decimal(measured.to(registry.Unit(dimension.si)).magnitude)
    except pint.UndefinedUnitError as error:
        raise InvalidInputError(
            f"{value!r} has the unknown unit {unit!r}{_did_you_mean(unit)}: write {_units(dimension)}"
        ) from error
    except pint.DimensionalityError as error:
        raise InvalidInputError(f"{value!r} is not {dimension.name}: write {_units(dimension)}") from error


@functools.cache
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(None, non_int_type=Decimal)
    for line in _DEFINITIONS.strip().splitlines():
        registry.define(line)
    return registry


def _did_you_mean(unit: str) -> str:
    known = ["um", "mm", "cm", "m", "in", "ft", "deg", "rad", "s", "ms", "min", "Hz", "kHz", "mm/s", "m/s", "deg/s"]
    folded = {name.lower(): name for name in known}
    close = difflib.get_close_matches(unit.lower(), folded, n=1, cutoff=0.5)
    return f" (did you mean {folded[close[0]]}?)" if close else ""


def _units(dimension: Dimension) -> str:
    if not dimension.usual:
        return "a plain number without unit"
    if not dimension.also:
        return f"it in {dimension.usual}"
    return f"it in {listed((dimension.usual, *dimension.also[:-1]))} or {dimension.also[-1]}"


def _with_unit(dimension: Dimension) -> str:
    return f" with its unit, like 5{_spaced(dimension.usual)}" if dimension.usual else ""


def _spaced(unit: str) -> str:
    return f" {unit}" if unit else ""
