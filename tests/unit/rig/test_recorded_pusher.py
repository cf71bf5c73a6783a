"""A set-up that asks for the recorded pusher: what it says, what it cannot say, what refuses it."""

from __future__ import annotations

import numpy as np
import pytest

import difffric as df
from difffric.errors import InputError
from difffric.rig.setup import Setup
from difffric.rig.setup_toml import format_setup, parse_setup

TEXT = """
[part]
mass_kg = 18.9

[friction]
mu_s = 0.141

[contact]
k_N_per_m = 8.0e5
b_N_s_per_m = 1500.0

[pusher]
motion = "recorded"
stroke_mm = 2.0
"""


def test_it_is_read_and_written_back_beside_the_stroke():
    setup = parse_setup(TEXT)
    assert setup.recorded_motion and setup.rig.pusher.stroke == 2e-3
    again = parse_setup(format_setup(setup))
    assert again.recorded_motion and again.rig == setup.rig
    assert not parse_setup(TEXT.replace('motion = "recorded"', "")).recorded_motion
    assert 'motion = "recorded"' in format_setup(Setup(setup.rig, recorded_motion=True))


def test_a_rig_alone_cannot_say_so(tmp_path):
    path = tmp_path / "setup.toml"
    path.write_text(TEXT)
    with pytest.raises(InputError, match="take `read_setup`"):
        df.load_setup(path)
    assert df.read_setup(path).recorded_motion


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("recorded", "measured"), '[pusher] motion: expected "recorded", got "measured"'),
        (('"recorded"', "true"), '[pusher] motion: expected "recorded", got true'),
        (("stroke_mm", "duration_ms"), "leave out [pusher] duration_ms"),
    ],
)
def test_another_word_and_another_motion_are_one_line(change, words):
    with pytest.raises(InputError) as refused:
        parse_setup(TEXT.replace(*change))
    assert words in str(refused.value) and "\n" not in str(refused.value)


def test_an_effect_of_the_pusher_has_no_place_beside_it():
    ramp = "\n[effects.pusher_ramp]\nacceleration_m_per_s2 = 5.0\n"
    with pytest.raises(InputError, match=r"leave out \[effects.pusher_ramp\]"):
        parse_setup(TEXT + ramp)


@pytest.mark.parametrize("ask", [df.fit, df.identify, df.diagnose])
def test_a_table_has_no_recorded_pusher(ask):
    force = np.array([150.0, 180.0, 181.0])
    table = df.Pushes(np.array([0.02, 0.05, 0.05]), force, np.full(3, 2e-3))
    with pytest.raises(InputError) as refused:
        ask(parse_setup(TEXT), table)
    assert "a table has no channel pusher" in str(refused.value)
    assert "\n" not in str(refused.value)
