"""setup.toml: what it means, every way in which it can be wrong, and writing it back."""

from __future__ import annotations

import dataclasses
import math
import os
import tomllib
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomlkit  # noqa: F401  so that no timed example pays for its import
from hypothesis import given, settings
from hypothesis import strategies as st

from difffric import units
from difffric.errors import InputError
from difffric.rig import catalogue
from difffric.rig.contact import AbstractContact
from difffric.rig.pusher import ConstantSpeed
from difffric.rig.quantities import QUANTITIES
from difffric.rig.rig import Rig, spring_damper_rig
from difffric.rig.sensors import ForceSensor, Probe
from difffric.rig.setup import Extras, Setup, check_rig
from difffric.rig.setup_toml import (
    format_setup,
    load_setup,
    parse_setup,
    read_setup,
    write_setup,
)

MINIMAL = """\
[part]
mass_kg = 18.9
[friction]
mu_s = 0.141
[contact]
k_N_per_m = 8.0e5
b_N_s_per_m = 1500
"""

FULL = """\
[part]
mass_kg = 18.9

[friction]                    # equation (1)
mu_s = 0.141
mu_s_scatter = 0.015          # optional
mu_k_over_mu_s = 0.7
k_v_N_s_per_m = 5.0

[contact]                     # equation (2)
k_N_per_m = 8.0e5
b_N_s_per_m = 1500.0

[pusher]                      # optional
stroke_mm = 2.0

[force_sensor]
sensitivity_mV_per_N = 11.3
range_N = 400
rate_Hz = 100_000.0
noise_N = 0.5

[probe]
resolution_um = 0.5
noise_um = 0.3
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A setup.toml with the given text, in the folder that the test stands in."""
    monkeypatch.chdir(tmp_path)

    def make(text) -> Path:
        path = Path("setup.toml")
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return make


def problems(path) -> list[str]:
    with pytest.raises(InputError) as caught:
        read_setup(path)
    return str(caught.value).splitlines()


def with_line(section: str, line: str) -> str:
    """The minimal file with `line` in place of that key, or added to the section."""
    key = line.split(" = ")[0]
    lines = [kept for kept in MINIMAL.splitlines() if not kept.startswith(f"{key} =")]
    if f"[{section}]" not in lines:
        lines.append(f"[{section}]")
    lines.insert(lines.index(f"[{section}]") + 1, line)
    return "\n".join(lines)


# What a file means


def test_every_number_arrives_in_si(file):
    setup = read_setup(file(FULL))
    rig = setup.rig
    assert rig.mass == 18.9
    assert (rig.friction.mu_s, rig.friction.mu_k_over_mu_s, rig.friction.k_v) == (0.141, 0.7, 5.0)
    assert (rig.contact.k, rig.contact.b) == (8.0e5, 1500.0)
    assert rig.pusher.stroke == 2.0e-3
    assert rig.force_sensor == ForceSensor(11.3e-3, 400.0, 100e3, 0.5)
    assert rig.probe == Probe(0.5e-6, 0.3e-6)
    assert setup.mu_s_scatter == 0.015
    assert setup.extras == {}


def test_what_is_optional_has_defaults(file):
    setup = read_setup(file(MINIMAL))
    assert setup == Setup(spring_damper_rig(mass=18.9, mu_s=0.141, k=8.0e5, b=1500.0))
    assert setup.rig.friction.mu_k_over_mu_s == 0.75
    assert setup.rig.friction.k_v == 0.0
    assert setup.rig.pusher.stroke is None
    assert setup.rig.force_sensor == ForceSensor()
    assert setup.rig.probe == Probe()
    assert setup.mu_s_scatter is None


def test_the_papers_sensors_written_out_are_the_defaults(file):
    text = MINIMAL + "[force_sensor]\nsensitivity_mV_per_N = 11.2\n[probe]\nresolution_um = 0.02\n"
    assert load_setup(file(text)) == load_setup(file(MINIMAL))


def test_units_agree_with_units_py():
    known = {"mm": units.MM, "um": units.UM, "mV_per_N": units.MV, "ms": 1e-3}
    for q in QUANTITIES:
        suffix = next((suffix for suffix in known if q.key.endswith(f"_{suffix}")), None)
        assert float(q.unit) == known.get(suffix, 1.0) and q.per == 1, q.key


def test_load_setup_gives_the_rig_alone(file):
    assert load_setup(file(FULL)) == read_setup("setup.toml").rig
    assert isinstance(load_setup(str(Path("setup.toml").absolute())), Rig)


def test_table_form_keeps_its_extras(file):
    text = FULL.replace(
        "= 8.0e5",
        "= { value = 8.0e5, standard_error = 2e3, free = true, lower = 1e5, upper = 1e7 }",
    )
    text = text.replace("stroke_mm = 2.0", "stroke_mm = { value = 2, standard_error = 0.01 }")
    text = text.replace("mu_s_scatter = 0.015", "mu_s_scatter = { value = 0.015, free = false }")
    text = text.replace("mass_kg = 18.9", "mass_kg = { value = 18.9 }")
    setup = read_setup(file(text))
    assert setup.rig == read_setup(file(FULL)).rig
    assert setup.mu_s_scatter == 0.015
    assert setup.extras == {
        "k_N_per_m": Extras(standard_error=2e3, free=True, lower=1e5, upper=1e7),
        "pusher.stroke_mm": Extras(standard_error=0.01),
        "friction.mu_s_scatter": Extras(free=False),
        "mass_kg": Extras(),
    }


def test_bounds_are_in_the_files_unit_and_may_be_reached(file):
    text = MINIMAL + "[pusher]\nstroke_mm = { value = 2.1, lower = 2.1, upper = 3 }\n"
    assert load_setup(file(text)).pusher.stroke == 2.1e-3
    just_below = "b_N_s_per_m = { value = 1499.9999999999998, lower = 1500 }"
    assert load_setup(file(with_line("contact", just_below))).contact.b == pytest.approx(1500)


def test_a_byte_order_mark_and_windows_line_ends_are_fine(file):
    text = b"\xef\xbb\xbf" + FULL.replace("\n", "\r\n").encode()
    assert read_setup(file(text)) == read_setup(file(FULL))


def test_an_empty_table_of_effects_is_fine(file):
    assert read_setup(file(MINIMAL + "[effects]\n")) == read_setup(file(MINIMAL))


# Files that cannot be read


def test_missing_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert problems("setup.toml") == ["setup.toml: no such file"]


def test_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("setup.toml").mkdir()
    assert problems("setup.toml") == ["setup.toml: expected a TOML file, got a folder"]


def test_unreadable_file(file, monkeypatch):
    path = file(MINIMAL)

    def refuse(self):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", refuse)
    assert problems(path) == ["setup.toml: cannot be read: Permission denied"]


def test_not_utf8(file):
    text = "[part]\n# Prüfstand\n".encode("latin-1")
    assert problems(file(text)) == ["setup.toml: expected text in UTF-8, line 2 is not"]


def test_syntax_error_names_line_and_column(file):
    (problem,) = problems(file("[part]\nmass_kg = = 3\n"))
    assert problem.startswith("setup.toml: not valid TOML: ")
    assert "line 2, column 11" in problem


def test_a_key_given_twice_is_a_syntax_error(file):
    (problem,) = problems(file("[part]\nmass_kg = 3\nmass_kg = 4\n"))
    assert problem.startswith("setup.toml: not valid TOML: ")
    assert "line 3" in problem


# Files that say something wrong

BAD = [
    ("part", "mass_kg = 0", "[part] mass_kg: expected a number > 0, got 0"),
    ("part", "mass_kg = -18.9", "[part] mass_kg: expected a number > 0, got -18.9"),
    ("friction", "mu_s = 0.0", "[friction] mu_s: expected a number > 0, got 0.0"),
    ("friction", "mu_s = nan", "[friction] mu_s: expected a number > 0, got nan"),
    (
        "friction",
        "mu_s_scatter = 1",
        "[friction] mu_s_scatter: expected a number >= 0 and < 1, got 1",
    ),
    (
        "friction",
        "mu_s_scatter = -0.1",
        "[friction] mu_s_scatter: expected a number >= 0 and < 1, got -0.1",
    ),
    (
        "friction",
        "mu_k_over_mu_s = 1.01",
        "[friction] mu_k_over_mu_s: expected a number > 0 and <= 1, got 1.01",
    ),
    (
        "friction",
        "mu_k_over_mu_s = 0",
        "[friction] mu_k_over_mu_s: expected a number > 0 and <= 1, got 0",
    ),
    (
        "friction",
        "k_v_N_s_per_m = -1",
        "[friction] k_v_N_s_per_m: expected a number >= 0, got -1",
    ),
    ("contact", "k_N_per_m = -5.0", "[contact] k_N_per_m: expected a number > 0, got -5.0"),
    ("contact", "k_N_per_m = inf", "[contact] k_N_per_m: expected a finite number > 0, got inf"),
    ("contact", "k_N_per_m = 1e400", "[contact] k_N_per_m: expected a finite number > 0, got inf"),
    ("contact", "b_N_s_per_m = -1", "[contact] b_N_s_per_m: expected a number >= 0, got -1"),
    ("pusher", "stroke_mm = 0", "[pusher] stroke_mm: expected a number > 0, got 0"),
    ("pusher", "stroke_mm = inf", "[pusher] stroke_mm: expected a finite number > 0, got inf"),
    ("force_sensor", "range_N = 0", "[force_sensor] range_N: expected a number > 0, got 0"),
    ("force_sensor", "rate_Hz = -1", "[force_sensor] rate_Hz: expected a number > 0, got -1"),
    ("force_sensor", "noise_N = 0.0", "[force_sensor] noise_N: expected a number > 0, got 0.0"),
    (
        "force_sensor",
        "sensitivity_mV_per_N = 0",
        "[force_sensor] sensitivity_mV_per_N: expected a number > 0, got 0",
    ),
    ("probe", "resolution_um = 0", "[probe] resolution_um: expected a number > 0, got 0"),
    ("probe", "noise_um = nan", "[probe] noise_um: expected a number > 0, got nan"),
    # wrong types
    ("part", 'mass_kg = "18.9"', '[part] mass_kg: expected a number > 0, got "18.9"'),
    ("part", "mass_kg = true", "[part] mass_kg: expected a number > 0, got true"),
    ("part", "mass_kg = [18.9]", "[part] mass_kg: expected a number > 0, got a list"),
    ("part", "mass_kg = 2026-01-31", "[part] mass_kg: expected a number > 0, got 2026-01-31"),
    # unknown keys
    (
        "contact",
        "k_N_per_mm = 3",
        "[contact] k_N_per_mm: unknown key, did you mean k_N_per_m?",
    ),
    (
        "contact",
        "gap = 3",
        "[contact] gap: unknown key, known: k_N_per_m, b_N_s_per_m",
    ),
    (
        "contact",
        "stroke_mm = 3",
        "[contact] stroke_mm: unknown key here, it belongs in [pusher]",
    ),
    ("pushr", "a = 3", "[pushr]: unknown key, did you mean pusher?"),
    # the table form
    (
        "part",
        "mass_kg = { free = true }",
        "[part] mass_kg.value: missing, expected a number > 0",
    ),
    (
        "part",
        "mass_kg = { value = -1 }",
        "[part] mass_kg.value: expected a number > 0, got -1",
    ),
    (
        "part",
        "mass_kg = { value = { value = 1 } }",
        "[part] mass_kg.value: expected a number > 0, got a table",
    ),
    (
        "part",
        "mass_kg = { value = 1, standard_error = -0.1 }",
        "[part] mass_kg.standard_error: expected a number >= 0, got -0.1",
    ),
    (
        "part",
        "mass_kg = { value = 1, free = 1 }",
        "[part] mass_kg.free: expected true or false, got 1",
    ),
    (
        "part",
        "mass_kg = { value = 1, lower = nan }",
        "[part] mass_kg.lower: expected a number, got nan",
    ),
    (
        "part",
        "mass_kg = { value = 1, upper = inf }",
        "[part] mass_kg.upper: expected a finite number, got inf",
    ),
    (
        "part",
        "mass_kg = { value = 1, uper = 2 }",
        "[part] mass_kg.uper: unknown key, did you mean upper?",
    ),
    (
        "part",
        "mass_kg = { value = 1, lower = 2, upper = 2 }",
        "[part] mass_kg: expected lower < upper and the value between them, "
        "got lower = 2.0, value = 1.0, upper = 2.0",
    ),
    (
        "part",
        "mass_kg = { value = 1, lower = 2 }",
        "[part] mass_kg: expected lower < upper and the value between them, "
        "got lower = 2.0, value = 1.0",
    ),
    (
        "part",
        "mass_kg = { value = 4, lower = 2, upper = 3 }",
        "[part] mass_kg: expected lower < upper and the value between them, "
        "got lower = 2.0, value = 4.0, upper = 3.0",
    ),
]


@pytest.mark.parametrize(("section", "line", "expected"), BAD, ids=[line for _, line, _ in BAD])
def test_one_thing_wrong(file, section, line, expected):
    assert problems(file(with_line(section, line))) == [f"setup.toml: {expected}"]


@pytest.mark.parametrize("number", ["1" + "0" * 400, "1e999999999", "-1e400"])
@pytest.mark.parametrize("section_key", ["part mass_kg", "pusher stroke_mm", "probe noise_um"])
def test_numbers_beyond_floats_are_refused(file, section_key, number):
    section, key = section_key.split()
    (problem,) = problems(file(with_line(section, f"{key} = {number}")))
    assert problem.startswith(f"setup.toml: [{section}] {key}: expected a finite number > 0, got ")


def test_absurd_exponents_and_integers_are_refused(file):
    for number in ("1e99999999999999999999", "1" + "0" * 5000):
        (problem,) = problems(file(with_line("part", f"mass_kg = {number}")))
        assert problem.startswith("setup.toml: ")


@pytest.mark.parametrize(
    ("section", "key", "range"),
    [
        ("part", "mass_kg", "> 0"),
        ("friction", "mu_s", "> 0"),
        ("contact", "k_N_per_m", "> 0"),
        ("contact", "b_N_s_per_m", ">= 0"),
    ],
)
def test_missing_key(file, section, key, range):
    text = "\n".join(line for line in MINIMAL.splitlines() if not line.startswith(key + " "))
    assert problems(file(text)) == [
        f"setup.toml: [{section}] {key}: missing, expected a number {range}"
    ]


def test_an_empty_file_lacks_every_required_key(file):
    assert problems(file("")) == [
        "setup.toml: [part] mass_kg: missing, expected a number > 0",
        "setup.toml: [friction] mu_s: missing, expected a number > 0",
        "setup.toml: [contact] k_N_per_m: missing, expected a number > 0",
        "setup.toml: [contact] b_N_s_per_m: missing, expected a number >= 0",
    ]


def test_sections_must_be_tables(file):
    text = "pusher = 2\neffects = 3\n" + MINIMAL + "[[probe]]\nnoise_um = 1\n"
    assert problems(file(text)) == [
        "setup.toml: [pusher]: expected a table, got 2",
        "setup.toml: [probe]: expected a table, got a list",
        "setup.toml: [effects]: expected a table, got 3",
    ]


def test_a_key_outside_its_section(file):
    assert problems(file("stroke_mm = 2.0\n" + MINIMAL)) == [
        "setup.toml: stroke_mm: unknown key here, it belongs in [pusher]"
    ]


def test_all_problems_are_named_at_once(file):
    text = """\
[friction]
mu_s = "high"
mu_k_over_mu_s = 1.5
[contact]
k_N_m = 8e5
b_N_s_per_m = { value = -1, lower = nan, free = "yes" }
[pusher]
stroke_mm = -2
[effects.tilt]
alpha = 0.01
"""
    assert problems(file(text)) == [
        "setup.toml: [part] mass_kg: missing, expected a number > 0",
        'setup.toml: [friction] mu_s: expected a number > 0, got "high"',
        "setup.toml: [friction] mu_k_over_mu_s: expected a number > 0 and <= 1, got 1.5",
        "setup.toml: [contact] k_N_per_m: missing, expected a number > 0",
        "setup.toml: [contact] b_N_s_per_m.value: expected a number >= 0, got -1",
        'setup.toml: [contact] b_N_s_per_m.free: expected true or false, got "yes"',
        "setup.toml: [contact] b_N_s_per_m.lower: expected a number, got nan",
        "setup.toml: [contact] k_N_m: unknown key, did you mean k_N_per_m?",
        "setup.toml: [pusher] stroke_mm: expected a number > 0, got -2",
        "setup.toml: [effects.tilt] alpha: unknown key, did you mean alpha_rad?",
    ]


# Writing back

positive = st.floats(1e-12, 1e12)
anything_positive = st.floats(min_value=1e-300, max_value=1e300)
rigs = st.builds(
    spring_damper_rig,
    mass=anything_positive,
    mu_s=anything_positive,
    k=anything_positive,
    b=st.floats(0, 1e300),
    mu_k_over_mu_s=st.floats(0, 1, exclude_min=True),
    k_v=st.floats(0, 1e300),
    stroke=st.none() | anything_positive,
    force_sensor=st.builds(
        ForceSensor, positive, positive, positive, st.none() | anything_positive
    ),
    probe=st.builds(Probe, positive, st.none() | anything_positive),
)
extras = st.builds(
    Extras,
    standard_error=st.none() | st.floats(0, 1e300),
    free=st.none() | st.booleans(),
    lower=st.none() | st.floats(-1e300, 0),
    upper=st.none() | st.floats(min_value=1e305, allow_infinity=False),
)
required = st.sampled_from(["mass_kg", "mu_s", "k_N_per_m", "b_N_s_per_m", "probe.resolution_um"])


@given(rigs, st.none() | st.floats(0, 1, exclude_max=True), st.dictionaries(required, extras))
def test_a_setup_comes_back_as_it_was_written(tmp_path_factory, rig, scatter, extras):
    path = tmp_path_factory.getbasetemp() / "setup.toml"
    setup = Setup(rig, scatter, extras)
    write_setup(setup, path)
    assert read_setup(path) == setup


@given(rigs)
def test_a_rig_comes_back_as_it_was_written(tmp_path_factory, rig):
    path = tmp_path_factory.getbasetemp() / "rig.toml"
    write_setup(rig, path)
    assert load_setup(path) == rig


def test_what_is_written_is_what_a_person_would_write(tmp_path):
    path = tmp_path / "setup.toml"
    rig = spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500.0, stroke=2.1e-3)
    known = Extras(standard_error=2e3, free=True, lower=1e5, upper=1e7)
    write_setup(Setup(rig, 0.015, {"k_N_per_m": known}), path)
    assert (
        path.read_text()
        == """\
[part]
mass_kg = 18.9

[friction]
mu_s = 0.141
mu_s_scatter = 0.015
mu_k_over_mu_s = 0.75
k_v_N_s_per_m = 0.0

[contact]
k_N_per_m = { value = 800000.0, standard_error = 2000.0, free = true, lower = 100000.0, \
upper = 10000000.0 }
b_N_s_per_m = 1500.0

[pusher]
stroke_mm = 2.1

[force_sensor]
sensitivity_mV_per_N = 11.2
range_N = 446.0
rate_Hz = 200000.0

[probe]
resolution_um = 0.02
"""
    )


def test_comments_and_layout_stay_where_numbers_change(file, tmp_path):
    setup = read_setup(file(f"# the left bench\n{FULL}# end\n"))
    rig = eqx.tree_at(lambda r: (r.friction.mu_s, r.force_sensor.noise), setup.rig, (0.2, None))
    rig = catalogue.extended(rig, {"tilt": {"alpha_rad": 0.01}})
    extras = {"k_N_per_m": Extras(2e3, True), "tilt.alpha_rad": Extras(1e-3)}
    changed = dataclasses.replace(setup, rig=rig, extras=extras)
    write_setup(changed, tmp_path / "other.toml")
    text = (tmp_path / "other.toml").read_text()
    old, new = FULL.splitlines(), text.splitlines()
    assert new[0] == "# the left bench" and "# end" in new
    gone = {line.partition("#")[0].strip() for line in old} - {
        line.partition("#")[0].strip() for line in new
    }
    assert gone == {"mu_s = 0.141", "k_N_per_m = 8.0e5", "noise_N = 0.5"}
    assert [line.partition("#")[2] for line in new if "#" in line][1:-1] == [
        line.partition("#")[2] for line in old if "#" in line
    ]
    assert "k_N_per_m = { value = 800000.0, standard_error = 2000.0, free = true }" in text
    assert "[effects.tilt]\nalpha_rad = { value = 0.01, standard_error = 0.001 }\n" in text
    assert read_setup(tmp_path / "other.toml") == changed


def test_a_replaced_file_keeps_its_comments(file):
    path = file("# mine\n" + MINIMAL.replace("1500", "1500 # guessed"))
    write_setup(spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1400.0), path)
    assert path.read_text().startswith("# mine\n[part]\nmass_kg = 18.9\n")
    assert "\nb_N_s_per_m = 1400.0 # guessed\n" in path.read_text()


@pytest.mark.parametrize(
    "text",
    [
        "no TOML [",
        "part = 3\n",
        "[contact.k_N_per_m]\nvalue = 3 # a table of its own\n[friction]\nmu_s.value = 3\n",
        "[effects.tilt]\nalpha_rad = 1\n[part]\nmass_kg = 1\n[effects.stribeck]\nv_s_m_per_s = 1",
        '"part".mass_kg = 3\n',
        "effects = 1",
    ],
)
def test_whatever_it_replaces_a_file_says_what_the_setup_does(file, text):
    path = file(text)
    rig = spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1400.0, stroke=2e-3)
    for one in (rig, catalogue.extended(rig, {"tilt": {"alpha_rad": 0.01}})):
        write_setup(one, path)
        assert load_setup(path) == one


@settings(max_examples=30)
@given(rigs, st.dictionaries(required, extras))
def test_the_layout_of_any_file_carries_any_setup(rig, extras):
    setup = Setup(rig, None, extras, FULL)
    text = format_setup(setup)
    assert parse_setup(text) == setup
    for line in FULL.splitlines():
        key, _, comment = line.partition(" ")
        if "#" in comment and f"\n{key} " in f"\n{text}":
            assert comment[comment.index("#") :] in text


def test_what_a_command_has_fitted_is_signed_and_said():
    """In place of what the file said of other numbers; what is not fitted keeps its words."""
    first = "# Rig 7\n# A first set-up for a.csv, which a fit starts from, by difffric init.\n\n"
    text = (
        first
        + """[part]
mass_kg = 18.9  # weighed

[friction]
mu_s = 0.1  # a guess

[contact]
k_N_per_m = 1e5  # a guess
b_N_s_per_m = 10  # damper
"""
    )
    known = parse_setup(text)
    rig = dataclasses.replace(known.rig, friction=dataclasses.replace(known.rig.friction, mu_s=0.2))
    extras = {"k_N_per_m": Extras(standard_error=5.0)}
    fitted = dataclasses.replace(known, rig=rig, extras=extras, mu_s_scatter=0.02)
    signed = format_setup(fitted, signed="Calibrated on a.csv by difffric fit.")
    assert parse_setup(signed) == fitted
    assert signed == text.replace(
        first, "# Calibrated on a.csv by difffric fit.\n# Rig 7\n\n"
    ).replace("0.1  # a guess\n", "0.2  # fitted\nmu_s_scatter = 0.02  # fitted\n").replace(
        "1e5  # a guess", "{ value = 100000.0, standard_error = 5.0 }  # fitted"
    )
    again = format_setup(parse_setup(signed), signed="Calibrated on b.csv by difffric diagnose.")
    assert again == signed.replace("a.csv by difffric fit", "b.csv by difffric diagnose")
    assert "rate_Hz" not in signed  # which goes without saying


def test_jax_and_numpy_numbers_are_written(tmp_path):
    path = tmp_path / "setup.toml"
    write_setup(
        spring_damper_rig(mass=jnp.asarray(18.9), mu_s=np.float64(0.1), k=1000, b=jnp.asarray(3)),
        path,
    )
    assert load_setup(path) == spring_damper_rig(mass=18.9, mu_s=0.1, k=1000.0, b=3.0)


def test_an_infinite_stroke_is_written_as_none(tmp_path):
    path = tmp_path / "setup.toml"
    write_setup(spring_damper_rig(mass=1.0, mu_s=0.1, k=1e5, b=0.0, stroke=math.inf), path)
    assert "pusher" not in tomllib.loads(path.read_text())


class SoftPad(AbstractContact):
    k: float

    def approach(self, z, w):
        return self.k * z**2


def test_what_the_file_cannot_say_is_refused_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    good = spring_damper_rig(mass=1.0, mu_s=0.1, k=1e5, b=0.0)
    batch = spring_damper_rig(mass=jnp.ones(3), mu_s="0.1", k=1e5, b=0.0)

    def refused(setup):
        with pytest.raises(InputError) as caught:
            write_setup(setup, "setup.toml")
        assert os.listdir() == []
        return str(caught.value).splitlines()

    assert refused(batch) == [
        "setup.toml: [part] mass_kg: expected one number, got an array of shape (3,)",
        "setup.toml: [friction] mu_s: expected a number, got '0.1'",
    ]
    assert refused(eqx.tree_at(lambda rig: rig.contact, good, SoftPad(1e9))) == [
        "setup.toml: [contact]: expected UnilateralSpringDamper, got SoftPad"
    ]
    assert refused(spring_damper_rig(mass=math.nan, mu_s=-0.1, k=1e5, b=0.0)) == [
        "setup.toml: [part] mass_kg: expected a number > 0, got nan",
        "setup.toml: [friction] mu_s: expected a number > 0, got -0.1",
    ]
    assert refused(Setup(good, extras={"k": Extras(free=True)})) == [
        "setup.toml: k: the file has no such number"
    ]
    assert refused(Setup(good, extras={"pusher.stroke_mm": Extras(free=True)})) == [
        "setup.toml: [pusher] stroke_mm.value: missing, expected a number > 0"
    ]


def test_a_traced_rig_cannot_be_written(tmp_path):
    @jax.jit
    def write(mass):
        write_setup(spring_damper_rig(mass=mass, mu_s=0.1, k=1e5, b=0.0), tmp_path / "setup.toml")

    with pytest.raises(InputError, match=r"mass_kg: expected a number, got "):
        write(1.0)


def test_a_failed_write_leaves_the_old_file_whole(file, monkeypatch):
    path = file(FULL)

    def full_disk(source, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(InputError, match="cannot be written: No space left on device"):
        write_setup(load_setup(path), path)
    assert path.read_text() == FULL
    assert os.listdir() == ["setup.toml"]


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_setup(
            spring_damper_rig(mass=1.0, mu_s=0.1, k=1e5, b=0.0), tmp_path / "none" / "setup.toml"
        )


# Rigs built in Python


def test_a_good_rig_passes_unchanged():
    rig = spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=0.0, stroke=2e-3)
    assert check_rig(rig) is rig


def test_all_values_out_of_range_are_named():
    rig = spring_damper_rig(
        mass=-1, mu_s=0.0, k=math.inf, b=-2.0, mu_k_over_mu_s=1.5, k_v=math.nan, stroke=0.0
    )
    with pytest.raises(InputError) as caught:
        check_rig(rig)
    assert str(caught.value).splitlines() == [
        "rig.mass: expected a number > 0, got -1",
        "rig.friction.mu_s: expected a number > 0, got 0.0",
        "rig.friction.mu_k_over_mu_s: expected a number > 0 and <= 1, got 1.5",
        "rig.friction.k_v: expected a number >= 0, got nan",
        "rig.contact.k: expected a finite number > 0, got inf",
        "rig.contact.b: expected a number >= 0, got -2.0",
        "rig.pusher.stroke: expected a number > 0, got 0.0",
    ]


def test_arrays_are_checked_element_by_element():
    mass = jnp.array([[1.0, 2.0], [3.0, -4.0]])
    with pytest.raises(InputError, match=r"^rig.mass: .* > 0, got -4.0 at index 1, 1$"):
        check_rig(spring_damper_rig(mass=mass, mu_s=np.array([0.1, 0.2]), k=1e5, b=0.0))
    check_rig(spring_damper_rig(mass=jnp.abs(mass), mu_s=np.array([0.1, 0.2]), k=1e5, b=0.0))


def test_what_is_no_number_is_named():
    with pytest.raises(InputError, match=r"rig.mass: expected a number > 0, got '18.9'"):
        check_rig(spring_damper_rig(mass="18.9", mu_s=0.1, k=1e5, b=0.0))
    with pytest.raises(InputError, match=r"rig.friction.k_v: expected a number >= 0, got None"):
        check_rig(spring_damper_rig(mass=18.9, mu_s=0.1, k=1e5, b=0.0, k_v=None))


def test_a_stroke_may_be_infinite_but_not_nan():
    rig = spring_damper_rig(mass=1.0, mu_s=0.1, k=1e5, b=0.0)
    with_stroke = eqx.tree_at(lambda r: r.pusher, rig, ConstantSpeed(jnp.array([1e-3, jnp.inf])))
    assert check_rig(with_stroke) is with_stroke
    with pytest.raises(InputError, match=r"rig.pusher.stroke: .* got nan"):
        check_rig(dataclasses.replace(rig, pusher=ConstantSpeed(math.nan)))


def test_other_laws_and_traced_values_pass():
    rig = spring_damper_rig(mass=1.0, mu_s=0.1, k=1e5, b=0.0)
    soft = eqx.tree_at(lambda r: r.contact, rig, SoftPad(-1.0))
    assert check_rig(soft) is soft

    def normal_force(mass):
        return check_rig(spring_damper_rig(mass=mass, mu_s=0.1, k=1e5, b=0.0)).F_N

    assert jax.jit(normal_force)(-2.0) == -2.0 * units.GRAVITY
    assert jax.grad(normal_force)(1.0) == pytest.approx(units.GRAVITY)
    assert jax.vmap(normal_force)(jnp.array([1.0, -1.0])).shape == (2,)
