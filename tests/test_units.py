"""Lengths as people write them, and millimetres."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix.errors import InputError
from layerfix.units import MM_PER_UNIT, format_mm, mm_per_unit, one_or_two, parse_length_mm


@pytest.mark.parametrize(
    ("text", "value_mm"),
    [
        ("0.3mm", 0.3),
        ("0.3 mm", 0.3),
        ("  0.3  mm ", 0.3),
        (".5mm", 0.5),
        ("2.mm", 2),
        ("+1mm", 1),
        ("3e-1mm", 0.3),
        ("1E2um", 0.1),
        ("47um", 0.047),
        ("47µm", 0.047),  # micro sign
        ("47μm", 0.047),  # Greek letter
        ("47 microns", 0.047),
        ("500nm", 0.0005),
        ("2.5cm", 25),
        ("0.1in", 2.54),
        ("1 Inch", 25.4),
        ("2 inches", 50.8),
        ("1ft", 304.8),
        ("2 feet", 609.6),
        ("0.02m", 20),
        ("1 metre", 1000),
        ("2 Meters", 2000),
        ("3 millimeters", 3),
        ("3 millimetre", 3),
        ("1 centimetres", 10),
        ("20 micrometers", 0.02),
        ("0.3MM", 0.3),
    ],
)
def test_a_length_is_a_number_and_a_unit(text, value_mm):
    """With or without a space, in any unit, singular or plural, small or capital."""
    assert parse_length_mm(text) == pytest.approx(value_mm, rel=1e-12)


@pytest.mark.parametrize("text", ["", "mm", "0,3mm", "--1mm", "0.3mm 0.4mm", "1.2.3mm", "nan mm", "inf mm", "0.3m m"])
def test_what_is_not_a_length_is_quoted_with_an_example(text):
    """The message shows what was given and how a length looks."""
    with pytest.raises(InputError) as caught:
        parse_length_mm(text)
    assert str(caught.value) == f"'{text}' is not a length: write a number and a unit, such as 0.3mm or 47um"


@pytest.mark.parametrize("text", ["0.3", " 47 ", "1e-3"])
def test_a_number_without_a_unit_says_which_it_may_have_been(text):
    """0.3 may be millimetres or micrometres; the message offers both."""
    with pytest.raises(InputError) as caught:
        parse_length_mm(text)
    assert str(caught.value) == f"'{text}' has no unit: write {text.strip()}mm or {text.strip()}um"


@pytest.mark.parametrize("name", ["parsec", "e", "px", "mmm", "°"])
def test_an_unknown_unit_lists_the_known(name):
    """The message names the unit and the choices."""
    with pytest.raises(InputError, match=f"unknown unit '{name}': use one of um, mm, cm, in, ft, m"):
        mm_per_unit(name)


def test_a_length_in_an_unknown_unit_names_it():
    """The unit is what is wrong, so the unit is what the message names."""
    with pytest.raises(InputError, match="unknown unit 'furlongs'"):
        parse_length_mm("3 furlongs")


@pytest.mark.parametrize("text", ["0mm", "-0.3mm", "-1e-9um", "0.0in", "1e-400mm"])
def test_a_length_is_above_0(text):
    """Zero and less are refused; the message quotes the text."""
    with pytest.raises(InputError) as caught:
        parse_length_mm(text)
    assert str(caught.value) == f"'{text}' is not a usable length: it must be above 0"


def test_a_length_beyond_all_numbers_is_refused():
    """1e400 is no number that a computer holds."""
    with pytest.raises(InputError, match="'1e400mm' is not a usable length"):
        parse_length_mm("1e400mm")


@pytest.mark.parametrize("name", MM_PER_UNIT)
def test_every_unit_is_understood_in_its_plural_and_in_capitals(name):
    """`mm`, `mms`, `MM` are one unit."""
    assert mm_per_unit(name) == mm_per_unit(f"{name}s") == mm_per_unit(f" {name} ") == MM_PER_UNIT[name]
    if name != "µm":  # its capital is the Greek letter's
        assert mm_per_unit(name.upper()) == MM_PER_UNIT[name]


@pytest.mark.parametrize(
    ("value_mm", "text"),
    [
        (0.3, "0.3 mm"),
        (0.1, "0.1 mm"),
        (0.047, "47 µm"),
        (0.0472, "47.2 µm"),
        (0.00005, "0.05 µm"),
        (12.3456, "12.35 mm"),
        (218.88, "218.9 mm"),
        (0, "0 mm"),
        (-0.05, "-50 µm"),
        (1.0, "1 mm"),
    ],
)
def test_a_length_is_written_with_four_digits_and_in_um_below_a_tenth_of_a_mm(value_mm, text):
    """Short, and in the unit that people would use."""
    assert format_mm(value_mm) == text


@given(st.floats(1e-7, 1e6))
def test_what_is_written_can_be_read(value_mm):
    """parse_length_mm understands format_mm, to its four digits."""
    assert parse_length_mm(format_mm(value_mm)) == pytest.approx(value_mm, rel=6e-4)


@pytest.mark.parametrize("value", [3, 3.0, (3, 3), [3, 3.0]])
def test_one_number_stands_for_both_axes(value):
    """One number, or two; both as floats."""
    assert one_or_two(value, "radius", "px") == (3.0, 3.0)


@pytest.mark.parametrize("value", [(), (1,), (1, 2, 3), None, "wide", (1, None)])
def test_what_is_not_one_number_or_two_is_quoted(value):
    """The message says what it was meant to be, and shows it."""
    with pytest.raises(InputError) as caught:
        one_or_two(value, "radius", "px")
    assert str(caught.value) == f"radius {value} px: it is one number, or two"


@pytest.mark.parametrize("value", [0, -1, (1, 0), (float("nan"), 1), float("inf")])
def test_both_numbers_are_above_0_and_finite(value):
    """The message shows all that was given."""
    with pytest.raises(InputError) as caught:
        one_or_two(value, "radius", "px")
    assert str(caught.value) == f"radius {value} px: it must be above 0"
