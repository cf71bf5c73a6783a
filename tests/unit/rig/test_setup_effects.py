"""[effects.ID] of a setup.toml: what they mean, every way in which they can be wrong, and writing
them back. One table for all effects, the catalogue's own."""

from __future__ import annotations

import math
import os
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomlkit  # noqa: F401  so that no timed example pays for its import
from hypothesis import given, settings
from hypothesis import strategies as st

from difffric.calibration import calibrate
from difffric.calibration.result import Fit
from difffric.commands.reports.simulate import describe_simulation
from difffric.compute import pytrees
from difffric.errors import InputError
from difffric.measurements.pushes import Pushes
from difffric.rig import catalogue, friction, parameters
from difffric.rig.rig import spring_damper_rig
from difffric.rig.setup import Extras, Setup, check_rig
from difffric.rig.setup_toml import load_setup, read_setup, write_setup
from difffric.simulation.trajectory import simulate
from tests.unit.rig.test_setup_toml import MINIMAL

PLAIN = spring_damper_rig(mass=18.9, mu_s=0.141, k=8.0e5, b=1500.0)
PLAIN_2MM = parameters.with_stroke(PLAIN, 2e-3)
EVERY = list(catalogue.CATALOGUE.values())
each_effect = pytest.mark.parametrize("effect", EVERY, ids=lambda effect: effect.id)


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A setup.toml with some lines behind the minimal ones, in the folder that the test stands
    in."""
    monkeypatch.chdir(tmp_path)

    def make(text: str) -> Path:
        path = Path("setup.toml")
        path.write_text(MINIMAL + text)
        return path

    return make


def problems(path) -> list[str]:
    with pytest.raises(InputError) as caught:
        read_setup(path)
    return [line.removeprefix("setup.toml: ") for line in str(caught.value).splitlines()]


def typical(effect) -> dict[str, float]:
    """The effect's keys, none at its null but those that stay there."""
    return {key.name: key.null if key.fixed else key.typical for key in effect.keys}


def same(a, b) -> bool:
    """Whether two rigs are of one structure and hold the same numbers to the last digit."""
    leaves = jax.tree.leaves
    return jax.tree.structure(a) == jax.tree.structure(b) and leaves(a) == leaves(b)


# What a file means


@each_effect
def test_a_table_adds_the_effect(file, effect):
    text = f"[effects.{effect.id}]\n"
    text += "\n".join(f"{key} = {value!r}" for key, value in typical(effect).items())
    setup = read_setup(file(text))
    assert same(setup.rig, catalogue.extended(PLAIN, {effect.id: typical(effect)}))
    assert setup.extras == {}


def test_effects_stand_in_the_catalogues_order(file):
    text = "[effects.stribeck]\nv_s_m_per_s = 0.02\n[effects.tilt]\nalpha_rad = 0.01\n"
    law = load_setup(file(text)).friction
    assert type(law) is friction.Stribeck and type(law.law) is friction.Tilt
    assert law.law.law == PLAIN.friction


def test_missing_keys_are_null(file):
    path = file("[effects.friction_waviness]\nwavelength_m = 0.002\n")
    assert same(
        load_setup(path), catalogue.extended(PLAIN, {"friction_waviness": {"wavelength_m": 0.002}})
    )


@pytest.mark.parametrize("known", ["", "0.8", "{ value = 0.8, free = false, upper = 0.9 }"])
@pytest.mark.parametrize(
    ("ratio", "extras"),
    [
        ("0.6", {}),
        ("{ value = 0.6, free = true }", {"mu_k_over_mu_s": Extras(free=True)}),
    ],
)
def test_a_ratio_is_that_of_equation_1_and_overrides_it(file, known, ratio, extras):
    path = file(f"[effects.friction_ratio]\nratio = {ratio}\n")
    if known:
        said = f"[friction]\nmu_k_over_mu_s = {known}"
        path.write_text(path.read_text().replace("[friction]", said))
    setup = read_setup(path)
    assert setup.rig.friction.mu_k_over_mu_s == 0.6
    assert setup.extras == extras
    write_setup(setup, path)
    assert read_setup(path) == setup
    assert "effects" not in path.read_text()


def test_tables_of_numbers_are_kept_by_parameter_name(file):
    path = file("""
[effects.stribeck]
v_s_m_per_s = { value = 0.02, standard_error = 1e-3, free = true, upper = 0.1 }
delta = { value = 2, standard_error = 0.1 }
[effects.pusher_ramp]
acceleration_m_per_s2 = { value = 10, free = false }
""")
    setup = read_setup(path)
    sizes = {"stribeck": {"v_s_m_per_s": 0.02}, "pusher_ramp": {"acceleration_m_per_s2": 10.0}}
    assert same(setup.rig, catalogue.extended(PLAIN, sizes))
    assert setup.extras == {
        "stribeck.v_s_m_per_s": Extras(standard_error=1e-3, free=True, upper=0.1),
        "stribeck.delta": Extras(standard_error=0.1),
        "pusher_ramp.acceleration_m_per_s2": Extras(free=False),
    }
    assert setup.extras.keys() - set(parameters.names(setup.rig)) == {"stribeck.delta"}
    write_setup(setup, path)
    assert read_setup(path) == setup


def test_an_infinite_null_may_be_written(file):
    path = file("[effects.force_saturation]\nlevel_N = inf\n[effects.force_highpass]\ntau_s = inf")
    assert same(
        load_setup(path), catalogue.extended(PLAIN, {"force_saturation": {}, "force_highpass": {}})
    )


# What can be wrong

BAD = [
    ("[effects.stribek]\nv = 1", "[effects.stribek]: unknown effect, did you mean stribeck?"),
    ("[stribeck]\nv = 1", "[stribeck]: unknown table, expected [effects.stribeck]"),
    ("[efects.tilt]\nalpha_rad = 1", "[efects]: unknown key, did you mean effects?"),
    ("[effects]\ntilt = 1", "[effects.tilt]: expected a table, got 1"),
    ("[[effects.tilt]]\nalpha_rad = 1", "[effects.tilt]: expected a table, got a list"),
    (
        "[effects]\nalpha_rad = 1",
        "[effects] alpha_rad: unknown key here, it belongs in [effects.tilt]",
    ),
    ("[effects.tilt]", "[effects.tilt]: expected some of its keys: alpha_rad"),
    ("[effects.tilt]\nalpha = 1", "[effects.tilt] alpha: unknown key, did you mean alpha_rad?"),
    (
        "[effects.stribeck]\nalpha_rad = 1",
        "[effects.stribeck] alpha_rad: unknown key here, it belongs in [effects.tilt]",
    ),
    (
        "[effects.stribeck]\ntau_s = 1",
        "[effects.stribeck] tau_s: unknown key, known: v_s_m_per_s, delta",
    ),
    (
        "[effects.friction_drift]\nshare = 1",
        "[effects.friction_drift] share: unknown key, the record of each push says it",
    ),
    (
        "[effects.friction_ratio]",
        "[effects.friction_ratio] ratio: missing, expected a number > 0 and <= 1",
    ),
    (
        "[effects.friction_ratio]\ngap_m = 0.5\nratio = 1.1",
        "[effects.friction_ratio] ratio: expected a number > 0 and <= 1, got 1.1",
        "[effects.friction_ratio] gap_m: unknown key here, it belongs in [effects.initial_gap]",
    ),
    (
        "[effects.presliding]\nsigma_1_N_s_per_m = 1",
        "[effects.presliding] sigma_0_N_per_m: missing, expected a number > 0",
    ),
    (
        "[effects.presliding]\nsigma_0_N_per_m = inf",
        "[effects.presliding] sigma_0_N_per_m: expected a finite number > 0, got inf",
    ),
    (
        "[effects.stribeck]\nv_s_m_per_s = -0.1",
        "[effects.stribeck] v_s_m_per_s: expected a number >= 0, got -0.1",
    ),
    (
        "[effects.stribeck]\nv_s_m_per_s = true\ndelta = 0",
        "[effects.stribeck] v_s_m_per_s: expected a number >= 0, got true",
        "[effects.stribeck] delta: expected a number > 0, got 0",
    ),
    (
        "[effects.stribeck]\nv_s_m_per_s = { value = -1, free = 1, uper = 2 }",
        "[effects.stribeck] v_s_m_per_s.value: expected a number >= 0, got -1",
        "[effects.stribeck] v_s_m_per_s.free: expected true or false, got 1",
        "[effects.stribeck] v_s_m_per_s.uper: unknown key, did you mean upper?",
    ),
    (
        "[effects.stribeck]\nv_s_m_per_s = { value = 1, lower = 2 }",
        "[effects.stribeck] v_s_m_per_s: expected lower < upper and the value between them, "
        "got lower = 2.0, value = 1.0",
    ),
    (
        "[effects.friction_waviness]\namplitude = 1.1\nwavelength_m = 0\nphase_rad = inf",
        "[effects.friction_waviness] amplitude: expected a number >= -1 and <= 1, got 1.1",
        "[effects.friction_waviness] wavelength_m: expected a number > 0, got 0",
        "[effects.friction_waviness] phase_rad: expected a finite number, got inf",
    ),
    (
        "[effects.friction_drift]\ndrift = -1.1",
        "[effects.friction_drift] drift: expected a number >= -1, got -1.1",
    ),
    (
        "[effects.pusher_ramp]\nacceleration_m_per_s2 = 0",
        "[effects.pusher_ramp] acceleration_m_per_s2: expected a number > 0, or inf, got 0",
    ),
    (
        "[effects.force_saturation]\nlevel_N = nan",
        "[effects.force_saturation] level_N: expected a number > 0, or inf, got nan",
    ),
]


@pytest.mark.parametrize(
    ("text", "expected"), [(text, lines) for text, *lines in BAD], ids=[text for text, *_ in BAD]
)
def test_what_is_wrong_is_named(file, text, expected):
    assert problems(file(text)) == expected


def test_everything_wrong_is_named_at_once(file):
    *known, unknown = problems(
        file("[pusher]\nstroke_mm = 0\n[effects.pusher_lag]\ntau_s = -1\n[effects.foo]\n")
    )
    assert known == [
        "[pusher] stroke_mm: expected a number > 0, got 0",
        "[effects.pusher_lag] tau_s: expected a number >= 0, got -1",
    ]
    assert unknown.startswith("[effects.foo]: unknown effect, known: friction_ratio, tilt, ")


@each_effect
def test_a_fit_that_ends_at_a_bound_can_be_written(tmp_path, effect):
    """The bounds between which a parameter makes sense are those that the file takes."""
    for key in effect.keys:
        for bound in (key.lower, key.upper):
            if not key.fixed and np.isfinite(bound) and (bound != 0 or key.null == 0):
                rig = catalogue.extended(PLAIN, {effect.id: typical(effect) | {key.name: bound}})
                write_setup(rig, tmp_path / "setup.toml")
                assert same(load_setup(tmp_path / "setup.toml"), rig)


# Writing back


def number(key):
    """Any value of a key that the file takes."""
    if key.name == "start_m":
        return st.floats(0, 1e300)
    lower, upper = max(key.lower, -1e300), min(key.upper, 1e300)
    lower = 1e-300 if lower == 0 and key.null != 0 else lower
    return st.floats(lower, upper)


extras = st.none() | st.builds(
    Extras, standard_error=st.none() | st.floats(0, 1e300), free=st.none() | st.booleans()
)


@each_effect
@settings(max_examples=30)
@given(st.data())
def test_an_effect_comes_back_as_it_was_written(tmp_path_factory, effect, data):
    path = tmp_path_factory.getbasetemp() / "effect.toml"
    values = {key.name: data.draw(number(key), key.name) for key in effect.keys}
    rig = catalogue.extended(PLAIN, {effect.id: values})
    inverse = [f"{effect.id}.{key.name}" for key in effect.keys if key.inverse]
    if inverse and data.draw(st.booleans(), "from a fit"):  # any float, not only an inverse of one
        held = {name: data.draw(st.floats(1e-300, 1e300), name) for name in inverse}
        rig = catalogue.with_numbers(rig, held)
    tables = {f"{effect.id}.{key}": data.draw(extras, f"extras of {key}") for key in values}
    setup = Setup(rig, None, {name: x for name, x in tables.items() if x is not None})
    write_setup(setup, path)
    found = read_setup(path)
    assert same(found.rig, rig) and found.extras == setup.extras


@given(st.floats(1e-300, 1e300))
def test_an_inverse_is_written_as_a_person_wrote_it(tmp_path_factory, acceleration):
    path = tmp_path_factory.getbasetemp() / "inverse.toml"
    number = float(f"{acceleration:.12g}")
    write_setup(catalogue.extended(PLAIN, {"pusher_ramp": {"acceleration_m_per_s2": number}}), path)
    assert f"\nacceleration_m_per_s2 = {number!r}\n" in path.read_text()


def test_all_effects_at_once_come_back(tmp_path):
    path = tmp_path / "setup.toml"
    all_of_them = catalogue.extended(PLAIN, {effect.id: typical(effect) for effect in EVERY})
    for rig in (all_of_them, catalogue.universal(PLAIN)):
        write_setup(rig, path)
        assert same(load_setup(path), rig)


def test_jax_numbers_are_written_and_what_pushes_say_is_not(tmp_path):
    path = tmp_path / "setup.toml"
    drift = {"drift": jnp.asarray(0.1), "share": 0.5}
    write_setup(catalogue.extended(PLAIN, {"friction_drift": drift}), path)
    assert same(load_setup(path), catalogue.extended(PLAIN, {"friction_drift": {"drift": 0.1}}))


class Greased(friction.AbstractFrictionEffect):
    law: friction.AbstractFriction

    def breakaway(self, F_N):
        return 0.5 * self.law.breakaway(F_N)


def test_what_the_file_cannot_say_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def refused(setup):
        with pytest.raises(InputError) as caught:
            write_setup(setup, "setup.toml")
        assert os.listdir() == []
        return str(caught.value).splitlines()

    def around(*laws):
        law = PLAIN.friction
        for outer in laws:
            law = outer(law)
        return eqx.tree_at(lambda rig: rig.friction, PLAIN, law)

    expected = "setup.toml: [friction]: expected the catalogue's effects in its order, got "
    for laws in (
        (friction.Stribeck, friction.Tilt),
        (friction.Tilt, friction.Tilt),
        (friction.Tilt, Greased),
    ):
        names = " within ".join(law.__name__ for law in laws)
        assert refused(around(*laws)) == [expected + names]
    assert refused(Setup(PLAIN, extras={"tilt.alpha_rad": Extras(free=True)})) == [
        "setup.toml: tilt.alpha_rad: the file has no such number"
    ]
    assert refused(catalogue.extended(PLAIN, {"presliding": {}})) == [
        "setup.toml: [effects.presliding] sigma_0_N_per_m: expected a finite number > 0, got inf"
    ]
    batch = catalogue.extended(PLAIN, {"pusher_ramp": {"acceleration_m_per_s2": jnp.ones(3)}})
    assert refused(batch) == [
        "setup.toml: [effects.pusher_ramp] acceleration_m_per_s2: expected one number, "
        "got an array of shape (3,)"
    ]


# Rigs built in Python


def test_good_rigs_pass_unchanged():
    every = catalogue.extended(PLAIN, {effect.id: typical(effect) for effect in EVERY})
    for rig in (
        every,
        catalogue.universal(PLAIN),
        catalogue.universal(pytrees.replicate(PLAIN, 3)),
    ):
        assert check_rig(rig) is rig


def test_all_values_out_of_range_are_named():
    sizes = {
        "stribeck": {"v_s_m_per_s": -0.1},
        "friction_patch": {"amplitude": jnp.array([0.1, -2.0])},
        "pusher_ramp": {"acceleration_m_per_s2": jnp.array([[10.0, -5.0]])},
        "force_saturation": {"level_N": math.nan},
        "force_gain": {"factor": "1"},
    }
    rig = catalogue.extended(spring_damper_rig(mass=1.0, mu_s=-0.1, k=1e5, b=0.0), sizes)
    with pytest.raises(InputError) as caught:
        check_rig(rig)
    assert str(caught.value).splitlines() == [
        "rig.friction.mu_s: expected a number > 0, got -0.1",
        "friction_patch.amplitude: expected a number >= -1, got -2.0 at index 1",
        "stribeck.v_s_m_per_s: expected a number >= 0, got -0.1",
        "pusher_ramp.acceleration_m_per_s2: expected a number > 0, or inf, got -5.0 at index 0, 1",
        "force_gain.factor: expected a number > 0, got '1'",
        "force_saturation.level_N: expected a number > 0, or inf, got nan",
    ]


def test_traced_values_pass():
    def load(alpha):
        return check_rig(catalogue.extended(PLAIN, {"tilt": {"alpha_rad": alpha}})).F_N

    assert jax.grad(load)(0.0) == 0.0


# What commands make of it

STRIBECK = "[pusher]\nstroke_mm = 2\n[effects.stribeck]\nv_s_m_per_s = {}\n"


def test_simulate_takes_the_effect(file):
    found = describe_simulation(load_setup(file(STRIBECK.format(0.02))), 0.05)
    push = simulate(catalogue.extended(PLAIN_2MM, {"stribeck": {"v_s_m_per_s": 0.02}}), 0.05)
    # Two integrators: NumPy's steps, and the compiled ones.
    assert found["peak_force_N"] == pytest.approx(float(push.peak_force), rel=1e-7)
    assert found["sliding_distance_m"] == pytest.approx(float(push.sliding_distance), rel=1e-7)
    assert found["derivatives"]["sliding_distance_m"]["stribeck.v_s_m_per_s"] < 0


def test_fit_frees_what_the_file_frees_and_the_answer_can_be_written(file, monkeypatch):
    """The search itself is not run: programs of extended rigs compile for half a minute."""
    setup = read_setup(file(STRIBECK.format("{ value = 0.02, free = true, upper = 0.1 }")))
    seen = []

    def search(model, *_):
        seen.append(model.layout)
        raise InputError("enough")

    monkeypatch.setattr(calibrate, "fit_from_starts", search)
    speeds = np.linspace(0.02, 0.09, 8)
    pushes = Pushes(speeds, speeds * 3000, speeds**2)
    with pytest.raises(InputError, match="enough"):
        calibrate.fit(setup, pushes)
    (layout,) = seen
    at = layout.names.index("stribeck.v_s_m_per_s")
    assert layout.value(layout.start)["stribeck.v_s_m_per_s"] == pytest.approx(0.02, rel=1e-15)
    assert layout.value(layout.upper)["stribeck.v_s_m_per_s"] == pytest.approx(0.1, rel=1e-15)

    n, nothing_searched = layout.n_free, None
    rig = parameters.with_values(setup.rig, {"stribeck.v_s_m_per_s": jnp.asarray(0.03)})
    found = Fit(
        rig, "table", layout.labels, layout.names, layout.start, (), np.eye(n), np.zeros(n),
        np.full(n, 9.0), 0.01, 0.001, np.nan, np.nan, 1.0, 1, True, (1, 1), (), speeds, speeds,
        speeds, speeds, speeds, nothing_searched, setup, pushes,
    )  # fmt: skip
    write_setup(found.fitted_setup, "setup.toml")
    written = read_setup("setup.toml")
    assert same(written.rig, catalogue.extended(PLAIN_2MM, {"stribeck": {"v_s_m_per_s": 0.03}}))
    error = found.standard_error(layout.labels[at])
    assert written.extras["stribeck.v_s_m_per_s"] == Extras(error, True, None, 0.1)


@pytest.mark.parametrize("component", ["force_sensor", "probe"])
def test_an_effect_keeps_its_sensor_s_numbers(component):
    """The same hardware stands behind an effect of its reading."""
    plain = spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500.0)
    real = catalogue.universal(plain)
    for name in ("sensitivity", "range", "rate", "noise", "resolution"):
        if hasattr(getattr(plain, component), name):
            assert getattr(getattr(real, component), name) == getattr(
                getattr(plain, component), name
            )


def test_older_share_of_the_damper_is_read_as_the_coefficient_that_it_was(file):
    """b = 1500 N s/m in the set-up; share = 0.4 was b_r = 600 N s/m."""
    older = read_setup(file("[effects.rebound_damping]\nshare = { value = 0.4, free = true }\n"))
    now = read_setup(
        file("[effects.rebound_damping]\nb_N_s_per_m = { value = 600, free = true }\n")
    )
    name = "rebound_damping.b_N_s_per_m"
    assert parameters.values(older.rig)[name] == parameters.values(now.rig)[name] == 600
    assert older.extras[name] == now.extras[name]


def test_a_share_and_a_coefficient_together_are_refused(file):
    assert problems(file("[effects.rebound_damping]\nshare = 0.4\nb_N_s_per_m = 600\n"))


@pytest.mark.parametrize("share", ["1.5", "-0.1", "inf", "nan", "1e999995", '"x"', "true"])
@pytest.mark.parametrize("entry", ["{}", "{{ value = {} }}"])
def test_what_is_no_share_is_told_in_a_line(file, share, entry):
    (problem,) = problems(file(f"[effects.rebound_damping]\nshare = {entry.format(share)}\n"))
    assert problem.startswith("[effects.rebound_damping] share: expected a number >= 0 and <= 1")


def test_a_share_of_no_number_is_told_with_that(file):
    """An endless damper on approach, of which a share of nothing is no number."""
    path = file("[effects.rebound_damping]\nshare = 0\n")
    path.write_text(path.read_text().replace("b_N_s_per_m = 1500", "b_N_s_per_m = inf"))
    assert any(x.startswith("[contact] b_N_s_per_m: expected") for x in problems(path))


def test_duration_of_the_pusher_is_its_effect(file, tmp_path):
    """46 ms beside the stroke are 0.046 s in the effect's table, bounds and errors with them."""
    table = "{ value = 46, standard_error = 2, lower = 30, upper = 60 }"
    short = read_setup(file(f"[pusher]\nduration_ms = {table}\n"))
    table = "{ value = 0.046, standard_error = 0.002, lower = 0.03, upper = 0.06 }"
    whole = read_setup(file(f"[effects.pusher_duration]\nduration_s = {table}\n"))
    assert eqx.tree_equal(short.rig, whole.rig)
    assert short.extras == whole.extras
    write_setup(short, tmp_path / "again.toml")
    assert eqx.tree_equal(read_setup(tmp_path / "again.toml").rig, whole.rig)


@pytest.mark.parametrize("given", ["-3", "0", '"46"'])
def test_a_duration_that_is_none_is_told(file, given):
    (problem,) = problems(file(f"[pusher]\nduration_ms = {given}\n"))
    assert problem.startswith("[pusher] duration_ms: expected a number > 0")
