import math
import subprocess
import sys

import pint
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InvalidInputError
from cellwright.quantities import (
    ANGLE,
    ANGULAR_ACCELERATION,
    ANGULAR_SPEED,
    AREAL_DENSITY,
    FINE_LENGTH,
    FREQUENCY,
    LENGTH,
    NUMBER,
    SHARE,
    SPEED,
    TIME,
    Dimension,
    format_quantity,
    parse_quantity,
)

NUMBERS = st.floats(min_value=-1e9, max_value=1e9, allow_nan=False).filter(lambda x: x == 0 or abs(x) > 1e-9)
CASES = [
    ("182 mm", LENGTH, 0.182),
    ("100 um", LENGTH, 1e-4),
    ("100 µm", FINE_LENGTH, 1e-4),
    ("2 in", LENGTH, 0.0508),
    ("1e-3 m", LENGTH, 1e-3),
    (".5m", LENGTH, 0.5),
    ("31 deg", ANGLE, math.radians(31)),
    ("31°", ANGLE, math.radians(31)),
    ("-0.5 rad", ANGLE, -0.5),
    ("0.01 /mm^2", AREAL_DENSITY, 1e4),
    ("0.01 1/mm^2", AREAL_DENSITY, 1e4),
    ("0.01/mm²", AREAL_DENSITY, 1e4),
    ("0.01 points/mm^2", AREAL_DENSITY, 1e4),
    ("100 Hz", FREQUENCY, 100.0),
    ("95 %", SHARE, 0.95),
    (0.95, SHARE, 0.95),
    ("0.5 m/s", SPEED, 0.5),
    ("3 m/min", SPEED, 0.05),
    ("250 ms", TIME, 0.25),
    ("60 rpm", ANGULAR_SPEED, 2 * math.pi),
    ("90 deg/s^2", ANGULAR_ACCELERATION, math.pi / 2),
    (7, NUMBER, 7.0),
    ("7", NUMBER, 7.0),
]


@pytest.mark.parametrize(("written", "dimension", "si"), CASES)
def test_quantities_become_si(written: str | float, dimension: Dimension, si: float) -> None:
    assert parse_quantity(written, dimension) == pytest.approx(si, rel=1e-15)


@settings(deadline=None)
@given(NUMBERS, st.sampled_from(["um", "mm", "cm", "m", "in", "ft"]))
def test_lengths_agree_with_pints_own_registry(number: float, unit: str) -> None:
    peer = pint.Quantity(number, unit).to("m").magnitude
    assert parse_quantity(f"{number!r} {unit}", LENGTH) == pytest.approx(peer, rel=1e-12)


@settings(deadline=None)
@given(st.integers(-(10**6), 10**6))
def test_conversion_gives_the_nearest_float(number: int) -> None:
    assert parse_quantity(f"{number} mm", LENGTH) == number / 1000
    assert parse_quantity(f"{number} um", LENGTH) == number / 1_000_000


@settings(deadline=None)
@given(NUMBERS)
def test_a_written_quantity_reads_back(number: float) -> None:
    for dimension in (LENGTH, ANGLE, AREAL_DENSITY, SPEED, ANGULAR_SPEED, FREQUENCY, SHARE):
        text = format_quantity(number, dimension, digits=17)
        assert parse_quantity(text, dimension) == pytest.approx(number, rel=1e-14)


@settings(deadline=None)
@given(NUMBERS)
def test_a_bare_number_is_no_length_and_the_message_shows_the_mend(number: float) -> None:
    with pytest.raises(InvalidInputError, match="has no unit but a length needs one: write") as caught:
        parse_quantity(number, LENGTH)
    mended = str(caught.value).rsplit("write ", 1)[1]
    assert parse_quantity(mended, LENGTH) == pytest.approx(number / 1000)


@pytest.mark.parametrize(
    ("written", "dimension", "words"),
    [
        ("5 mmm", LENGTH, "unknown unit 'mmm' (did you mean mm?)"),
        ("5 MM", LENGTH, "did you mean mm?"),
        ("5 deg", LENGTH, "is not a length: write it in mm"),
        ("5 %", ANGLE, "is not an angle: write it in deg or rad"),
        ("5 Hz", ANGULAR_SPEED, "is not an angular speed"),
        ("5 deg/s", FREQUENCY, "is not a frequency"),
        ("5 deg", SHARE, "is not a share"),
        ("5 mm", NUMBER, "write a plain number without unit"),
        ("5,5 mm", LENGTH, "has a comma: write 5.5 mm"),
        ("1,500 mm", LENGTH, "write 1500 mm or 1.500 mm"),
        ("2 * 3 mm", LENGTH, "unreadable unit"),
        ("5 mm/", LENGTH, "unreadable unit"),
        ("5 mm^99", LENGTH, "unreadable unit"),
        ("1e999 mm", LENGTH, "is not finite"),
        ("1e400", NUMBER, "is not finite"),
        ("long", LENGTH, "is not a length: write a number with its unit, like 5 mm"),
        ("", LENGTH, "is not a length"),
        (math.nan, NUMBER, "is not finite"),
        (math.inf, LENGTH, "is not finite"),
        (None, LENGTH, "nothing is not a length"),
        (True, NUMBER, "is not a pure number"),
        ([1], LENGTH, "is not a length"),
    ],
)
def test_what_is_no_quantity_is_refused_with_a_mend(written: object, dimension: Dimension, words: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        parse_quantity(written, dimension)
    assert words in str(caught.value)


@settings(deadline=None)
@given(st.text(max_size=30))
def test_any_text_gives_a_finite_number_or_the_error(text: str) -> None:
    try:
        assert math.isfinite(parse_quantity(text, LENGTH))
    except InvalidInputError as error:
        assert repr(text) in str(error)


def test_importing_the_module_does_not_import_pint() -> None:
    code = "import cellwright.quantities, sys; sys.exit('pint' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
