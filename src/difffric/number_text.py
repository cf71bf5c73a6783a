"""Numbers as texts for a person, in reports, figures and messages."""

from __future__ import annotations

import math
from collections.abc import Mapping

MISSING = "–"
"""What stands where there is no number."""
_PLAIN_BELOW = 1e5
"""Numbers below it are written without a power of ten: 1890, not 1.89e+03."""


def format_number(value: float | None, digits: int = 4, unit: str = "") -> str:
    """Return a number to so many significant digits, with its unit; a dash where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return MISSING
    text = f"{value:.{digits}g}"
    if "e+" in text and abs(float(text)) < _PLAIN_BELOW:
        text = f"{float(text):.0f}"
    return f"{text}{' ' + unit if unit else ''}"


def format_with_error(value: float | None, error: float | None, digits: int = 3) -> str:
    """Return "value ± error" to so many decimals; a dash where there is no value."""
    if value is None:
        return MISSING
    return (
        f"{value:.{digits}f} ± {error:.{digits}f}" if error is not None else f"{value:.{digits}f}"
    )


def format_pair(value: float | None, error: float | None) -> tuple[str, str]:
    """Return a value and its standard error, both to the second digit of the error.

    A dash stands for what is missing; a value without an error gets six digits.
    """
    if value is None or not math.isfinite(value):
        return MISSING, MISSING
    if error is None or not math.isfinite(error) or error <= 0:
        return format_number(value, 6), MISSING
    places = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{places}f}", f"{error:.{places}f}"


def format_values(values: Mapping[str, float]) -> str:
    """Return numbers with their names on one line: `k_N_per_m = 8.02e+05, mu_s = 0.141`."""
    return ", ".join(f"{name} = {format_number(value)}" for name, value in values.items())
