"""Units that are plainly wrong are said, and those of data that can be are never doubted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import difffric as df
from difffric.errors import InputError
from difffric.measurements.checks import check_data, refuse_constant_columns
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Channel, Recordings
from difffric.measurements.unit_checks import find_wrong_units, refuse_wrong_units
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.columns import observe_columns
from difffric.studies.published_tables import guess_rig, load_pushes

EXAMPLES = Path(__file__).parents[3] / "examples"
RIG = df.load_setup(EXAMPLES / "setup.toml")
TABLE = df.load(EXAMPLES / "pushes.csv")
SLIDES = df.load(EXAMPLES / "slides.csv")
RECORDINGS = df.load(EXAMPLES / "pushes.tdms")
MM_MIN = 1e-3 / 60
RIGS, EACH = 250, 8


def draw_tables(rng, stroke):
    """(what an engineer guessed of the rig, its pushes) for rigs of every kind: 0.1-2000 kg, mu_s
    0.03-0.9, k over four decades; the guess a factor of three off in mu_s and of ten in k and b."""

    def draw(low, high, n=RIGS):
        return np.exp(rng.uniform(np.log(low), np.log(high), n))

    m, mu, k, ratio = draw(0.1, 2000), draw(0.03, 0.9), draw(1e4, 1e8), rng.uniform(0.6, 1, RIGS)
    b = 2 * draw(0.02, 1.5) * np.sqrt(k * m)
    v = draw(300, 6000, RIGS * EACH).reshape(RIGS, EACH) * MM_MIN
    v[::4] = v[::4, :1]
    k_v = rng.choice([0, 0.5], RIGS) * mu * m * 9.8 / v.max(axis=1)
    way = draw(1e-4, 5e-3) if stroke else np.full(RIGS, np.nan)
    wide = [np.repeat(x, EACH) for x in (m, mu, k, b, ratio, k_v)]
    names = ("mass", "mu_s", "k", "b", "mu_k_over_mu_s", "k_v")
    rig = spring_damper_rig(**dict(zip(names, wide, strict=True)))
    if stroke:
        rig = df.rig.parameters.with_stroke(rig, np.repeat(way, EACH))
    seen = observe_columns(rig, v.ravel())
    F, d = (np.asarray(x).reshape(RIGS, EACH) for x in (seen.peak_force, seen.sliding_distance))
    d = np.where(d > 1e-9, d, np.nan)
    off = [draw(0.33, 3), draw(0.1, 10), draw(0.1, 10)]
    for i in range(RIGS):
        guess = spring_damper_rig(
            mass=m[i],
            mu_s=float(np.clip(mu[i] * off[0][i], 0.03, 0.9)),
            k=k[i] * off[1][i],
            b=b[i] * off[2][i],
        )
        yield guess, Pushes(v[i], F[i], d[i], stroke=np.full(EACH, way[i]))


@pytest.mark.parametrize("stroke", [True, False])
@pytest.mark.parametrize("seed", [1, 2])
def test_data_that_can_be_are_never_doubted(stroke, seed):
    for rig, pushes in draw_tables(np.random.default_rng(seed), stroke):
        assert find_wrong_units(pushes, rig) == []
        for name in ("peak_force", "sliding_distance"):
            if np.isfinite(getattr(pushes, name)).any():
                alone = replace(pushes, **{name: None})
                assert find_wrong_units(alone, rig) == []


def test_no_data_at_hand_are_doubted():
    for data in (TABLE, SLIDES, RECORDINGS, df.load(EXAMPLES / "watched.csv")):
        assert refuse_wrong_units(data, RIG) == ()
    hidden = EXAMPLES / "hidden"
    assert (
        refuse_wrong_units(df.load(hidden / "pushes.tdms"), df.load_setup(hidden / "setup.toml"))
        == ()
    )


WRONG = {
    "distances look like mm": ("sliding_distance", 1e-3),
    "distances look like in": ("sliding_distance", 1 / 25400),
    "distances look like m": ("sliding_distance", 1e-6),
    "forces look like kN": ("peak_force", 1e-3),
    "forces look like mN": ("peak_force", 1e3),
    "speeds look like m/s": ("velocity", MM_MIN),
    "speeds look like mm/s": ("velocity", 1 / 60),
    "speeds look like in/min": ("velocity", 1 / 25.4),
    "masses look like g": ("mass", 1e3),
}


@pytest.mark.parametrize("words", WRONG)
def test_a_column_in_another_unit_is_told_with_its_remedy(words):
    column, factor = WRONG[words]
    wrong = replace(TABLE, **{column: getattr(TABLE, column) * factor})
    (found,) = find_wrong_units(wrong, RIG)
    assert found.text.startswith(f"{words}, expected ")
    assert "call it mass_g" in found.text or f"call the column {column}_" in found.text
    assert found.impossible == (words != "forces look like mN")
    if found.impossible:
        with pytest.raises(InputError, match=f"{words}.*--trust-units"):
            refuse_wrong_units(wrong, RIG)
    else:
        assert refuse_wrong_units(wrong, RIG) == (found.text,)


def test_a_slide_a_set_up_and_two_columns_in_other_units_are_told():
    slides = replace(SLIDES, release_velocity=SLIDES.release_velocity / 60)
    assert find_wrong_units(slides, RIG)[0].text.startswith("speeds look like mm/s")
    slides = replace(SLIDES, sliding_distance=SLIDES.sliding_distance / 1000)
    assert find_wrong_units(slides, RIG)[0].text.startswith("distances look like mm")
    heavy = df.rig.parameters.with_values(RIG, {"mass_kg": 18900.0})
    bare = replace(TABLE, mass=None)
    assert "mass_kg = 18900 looks like g" in find_wrong_units(bare, heavy)[0].text
    both = replace(
        TABLE,
        peak_force=TABLE.peak_force / 1000,
        sliding_distance=TABLE.sliding_distance / 1000,
    )
    text = find_wrong_units(both, RIG)[0].text
    assert "forces look like kN" in text and "distances look like mm" in text


def change_channels(**factors):
    """The recordings with channels times a factor, in a unit."""
    pushes = []
    for push in RECORDINGS:
        own = {name: getattr(push, name).scale(*how) for name, how in factors.items()}
        pushes.append(replace(push, **own))
    return Recordings(tuple(pushes), "pushes.tdms")


def test_recordings_are_held_to_the_same():
    with pytest.raises(InputError, match=r"look like mm.*the channel position the unit_string mm"):
        refuse_wrong_units(change_channels(position=(1e-3, "m")), RIG)
    with pytest.raises(InputError, match=r"look like kN.*the channel force the unit_string kN"):
        refuse_wrong_units(change_channels(force=(1e-3, "N")), RIG)


def test_a_channel_that_stays_at_one_value_is_told_once_for_all_pushes():
    for data, expected in (
        (change_channels(position=(0.0, "m")), "position is 0 um"),
        (set_force(3.5), "force is 3.5 N"),
    ):
        with pytest.raises(InputError) as caught:
            check_data(data, RIG)
        (line,) = str(caught.value).splitlines()
        assert expected in line and line.endswith("(in 14 of 14 pushes)")
    with pytest.raises(InputError, match="force is 0 N throughout: is the sensor connected"):
        refuse_wrong_units(set_force(0.0), RIG)


def set_force(value):
    """The recordings with a force that stays at a value."""
    samples = np.full(4000, value)
    force = Channel.of(samples, 1e-4, -0.02, "N")
    return Recordings(tuple(replace(push, force=force) for push in RECORDINGS), "pushes.tdms")


def test_a_channel_that_moves_by_one_step_is_not_constant():
    first = RECORDINGS[0]
    samples = np.zeros(4000)
    samples[-1] = 2e-8
    moved = replace(first, position=Channel.of(samples, 1e-4, 0.0, "m"))
    assert len(check_data(Recordings((moved,), "x"), RIG)) == 1


def test_constant_columns_are_told_where_the_speeds_differ():
    for name, value in (("sliding_distance", 2.84e-3), ("peak_force", 100.0)):
        stuck = replace(TABLE, **{name: np.full(len(TABLE), value)})
        with pytest.raises(InputError, match="in 14 of 14 pushes, at speeds that differ"):
            check_data(stuck, RIG)
        same = replace(stuck, velocity=np.full(len(TABLE), 0.05))
        refuse_constant_columns(same)
    refuse_constant_columns(TABLE)


def test_the_papers_tables_are_not_doubted():
    for stroke in (None, 2e-3):
        assert find_wrong_units(load_pushes(), guess_rig(stroke)) == []
