"""Numbers as a person reads them."""

import pytest

from difffric.number_text import format_number, format_pair, format_with_error


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (0.141234, 0.00106, ("0.1412", "0.0011")),
        (819996.18, 21.4, ("819996", "21")),
        (819996.18, 1570.2, ("819996", "1570")),
        (3.2, None, ("3.2", "–")),
        (3.2, float("nan"), ("3.2", "–")),
        (None, 1.0, ("–", "–")),
        (float("nan"), 1.0, ("–", "–")),
    ],
)
def test_numbers_are_shown_to_two_digits_of_their_error(value, error, shown):
    assert format_pair(value, error) == shown


@pytest.mark.parametrize(
    ("arguments", "shown"),
    [
        ((1234.5,), "1234"),
        ((1894.2, 3, "µm"), "1890 µm"),
        ((-11_912.0,), "-11910"),
        ((802_345.0, 3), "8.02e+05"),
        ((0.5, 3, "N"), "0.5 N"),
        ((None,), "–"),
        ((float("inf"),), "–"),
    ],
)
def test_a_number_has_so_many_digits_and_its_unit(arguments, shown):
    assert format_number(*arguments) == shown


def test_an_error_stands_beside_its_value():
    assert format_with_error(0.1412, 0.0031) == "0.141 ± 0.003"
    assert format_with_error(0.1412, None, 2) == "0.14" and format_with_error(None, 1.0) == "–"
