"""`[files]` of a setup.toml: the names that files of data have for what has others here."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from difffric.errors import InputError
from difffric.rig.rig import spring_damper_rig
from difffric.rig.setup import Setup
from difffric.rig.setup_toml import format_setup, parse_setup

PLAIN = format_setup(Setup(spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500.0)))
NAMES = st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), min_size=1)


def test_names_are_read_and_written_back_with_their_comments():
    text = PLAIN + '\n[files]  # the logger speaks German\nforce = "Kraft"\n'
    setup = parse_setup(text)
    assert setup.channels == {"force": "Kraft"}
    assert format_setup(setup) == text
    assert parse_setup(PLAIN).channels == {}


@given(st.dictionaries(NAMES, NAMES, max_size=3))
@settings(deadline=None)
def test_any_names_come_back_as_they_were_written(channels):
    setup = Setup(parse_setup(PLAIN).rig, channels=channels)
    assert parse_setup(format_setup(setup)).channels == channels


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("force = 7", "[files] force: expected a name in quotes, got 7"),
        ("force = { value = 7 }", "[files] force: expected a name in quotes, got a table"),
    ],
)
def test_what_is_no_name_is_refused(line, expected):
    with pytest.raises(InputError) as caught:
        parse_setup(f"{PLAIN}\n[files]\n{line}\n")
    assert expected in str(caught.value)
