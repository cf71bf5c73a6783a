"""Units of a recording that are plainly wrong are said, with the guess, and right ones are not."""

from dataclasses import replace

import pytest

from difffric.axis import AxisRecordings
from difffric.axis.unit_checks import refuse_wrong_units
from difffric.errors import InputError
from tests.reference.axis import Axis
from tests.unit.axis.made import ROUGH, make

COLUMNS = {"time": "time_s", "force": "force_N", "position": "position_mm"}


@pytest.fixture(scope="module")
def right():
    return replace(make(Axis(), seed=5), columns=COLUMNS)


def scale(data: AxisRecordings, name: str, factor: float) -> AxisRecordings:
    """The recording with one of its signals in another unit than it says."""
    return replace(
        data, stretches=[replace(x, **{name: factor * getattr(x, name)}) for x in data.stretches]
    )


def test_right_units_pass(right):
    refuse_wrong_units(ROUGH, right)


@pytest.mark.parametrize(
    ("name", "factor", "words"),
    [
        ("position", 1e-3, "position_mm looks like m, call the column position_m "),
        ("position", 1e3, "position_mm looks like um, call the column position_um "),
        ("force", 1e-3, "force_N looks like kN, call the column force_kN "),
        ("force", 1e3, "force_N looks like mN, call the column force_mN "),
        ("time", 1e-3, "its times are 1000 times too small"),
        ("time", 1e3, "time_s looks like ms, call the column time_ms "),
    ],
)
def test_a_wrong_unit_is_said_with_the_guess(right, name, factor, words):
    with pytest.raises(InputError) as found:
        refuse_wrong_units(ROUGH, scale(right, name, factor))
    assert words in str(found.value)
    assert "\n" not in str(found.value)


def test_without_a_heading_it_is_said_how_far_it_is_off(right):
    wrong = replace(scale(right, "position", 1e-3), columns={})
    with pytest.raises(InputError, match="its positions are 1000 times too small"):
        refuse_wrong_units(ROUGH, wrong)


def test_a_rough_set_up_is_none_of_the_units_fault(right):
    for mass, coulomb in ((3.0, 20.0), (3000.0, 20.0), (95.0, 2.0), (95.0, 500.0)):
        refuse_wrong_units(replace(ROUGH, mass=mass, coulomb=coulomb), right)
