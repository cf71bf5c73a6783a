"""`difffric init`: a set-up that reads back, whose k and b are near those that made the pushes."""

from __future__ import annotations

import json

import numpy as np
import pytest

import difffric as df
from difffric.commands.first_steps.first_setup import guess_contact
from difffric.measurements.pushes import Pushes
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.columns import observe_columns
from tests.commands.variants import EXAMPLES, GERMAN, M, Table

TRUTH = json.loads((EXAMPLES / "truth.json").read_text())["rigs"]["DRY"]
SPEEDS = np.array([800, 1500, 2500, 3500, 5000]) * 1e-3 / 60


@pytest.mark.parametrize("seed", range(5))
def test_the_guess_is_within_a_factor_of_four(seed):
    rng = np.random.default_rng(seed)
    m, mu = rng.uniform(5, 30), rng.uniform(0.08, 0.25)
    k, zeta = np.exp(rng.uniform(np.log(2e5), np.log(3e6))), rng.uniform(0.1, 0.5)
    b, stroke = 2 * zeta * np.sqrt(k * m), rng.uniform(1e-3, 3e-3)
    seen = observe_columns(spring_damper_rig(mass=m, mu_s=mu, k=k, b=b, stroke=stroke), SPEEDS)
    d = np.asarray(seen.sliding_distance)
    pushes = Pushes(SPEEDS, np.asarray(seen.peak_force), np.where(d > 0, d, np.nan))
    for slowing in ([], [0.75 * mu * 9.80665]):
        guess = guess_contact(pushes, m, stroke, slowing)
        assert k / 4 < guess[1] < 4 * k and b / 4 < guess[2] < 4 * b


@pytest.mark.parametrize("name", ["pushes.tdms", "pushes.csv"])
def test_a_set_up_is_written_that_a_fit_can_start_from(run, tmp_path, name):
    to = tmp_path / "setup.toml"
    code, said, _ = run("init", EXAMPLES / name, "--to", to, "--stroke-mm", 1.2)
    assert code == 0 and f"written to {to}" in said
    assert "from the file: mass 18.9 kg\n" in said  # the stroke was given
    assert "assumed, until you read your data sheets: sensitivity 11.2 mV/N, range 446 N" in said
    assert (
        "range_N = 446                 # assumed: put the value of your data sheet;"
        in to.read_text()
    )
    assert "stroke_mm = 1.2               # given with --stroke-mm; " in to.read_text()
    setup = df.read_setup(to)
    assert float(setup.rig.mass) == TRUTH["mass_kg"] and float(setup.rig.pusher.stroke) == 1.2e-3
    for value, key in ((setup.rig.contact.k, "k_N_per_m"), (setup.rig.contact.b, "b_N_s_per_m")):
        assert TRUTH[key] / 2 < float(value) < 2 * TRUTH[key]
    if name.endswith("tdms"):
        assert float(setup.rig.force_sensor.noise) == pytest.approx(0.5, rel=0.05)
    assert all("#" in line for line in to.read_text().splitlines() if "=" in line)
    assert run("init", EXAMPLES / name, "--to", to)[0] == 2  # it is there already


def test_foreign_names_go_into_the_set_up_and_a_mass_is_asked_for(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = Table(names=GERMAN | {M: "order_of_old"}).write(tmp_path / "pushes.csv")
    names = ("--channel", "velocity=Geschwindigkeit", "--channel", "force=Kraft")
    given = (*names, "--channel", "distance=Weg", "--skip-bad")
    code, _, said = run("init", data, *given)
    assert code == 2 and said == (
        "difffric: --mass-kg is missing: the data do not say the mass of the part\n"
    )
    assert run("init", data, *given, "--mass-kg", 18.9)[0] == 0
    setup = df.read_setup("setup.toml")
    assert setup.channels == {"velocity": "Geschwindigkeit", "force": "Kraft", "distance": "Weg"}
    read = df.load(data, channels=setup.channels, skip_bad=True)
    assert np.array_equal(read.velocity, df.load(EXAMPLES / "pushes.csv").velocity)


def test_a_mass_that_the_file_contradicts_is_refused(run, tmp_path):
    to = tmp_path / "setup.toml"
    for given, words in (
        (18900, "; was it meant in grams?"),
        (12, ": expected the same, or no option"),
    ):
        code, _, said = run("init", EXAMPLES / "pushes.csv", "--to", to, "--mass-kg", given)
        assert code == 2 and not to.exists()
        assert said == f"difffric: --mass-kg {given}: the file says 18.9 kg{words}\n"
    assert run("init", EXAMPLES / "pushes.csv", "--to", to, "--mass-kg", 18.85)[0] == 0
    to.write_text(to.read_text().replace("mass_kg = 18.85", "mass_kg = 18900"))
    code, _, said = run("check", EXAMPLES / "pushes.csv", "--setup", to)
    assert code == 2 and "the set-up's mass looks like g, expected kg: write mass_kg = 18.9" in said


def test_the_place_of_a_stroke_is_shown_where_nothing_says_it(run, tmp_path):
    text = (EXAMPLES / "pushes.csv").read_text()
    data, to = tmp_path / "pushes.csv", tmp_path / "setup.toml"
    data.write_text(text.replace("stroke_mm", "note", 1))
    assert run("init", data, "--to", to, "--skip-bad")[0] == 0
    assert df.read_setup(to).rig.pusher.stroke is None
    assert "# stroke_mm = " in to.read_text()
