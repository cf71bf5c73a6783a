"""`difffric fit` and `difffric identify` as a user types them, on the examples and on bad input."""

from __future__ import annotations

import json
import re
import sys
from contextlib import nullcontext, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import difffric as df
from difffric.commands import main
from difffric.commands.reports.identify import summarise_conditions
from difffric.identification.estimates import NONE, Estimate, Identified, PushFriction
from difffric.measurements.files.tdms_writer import write_recordings
from difffric.measurements.recordings import Channel
from difffric.rig import parameters
from difffric.rig.setup import Extras, Setup
from difffric.rig.setup_toml import read_setup

EXAMPLES = Path(__file__).parents[2] / "examples"
SETUP, CSV, TDMS = (EXAMPLES / name for name in ("setup.toml", "pushes.csv", "pushes.tdms"))
TRUTH = json.loads((EXAMPLES / "truth.json").read_text())


class Done(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def run(monkeypatch, capfd):
    """A command line, in this process: exit status and what it said."""
    return _runner(monkeypatch, capfd)


def _runner(monkeypatch, capture=None):
    monkeypatch.setattr(main, "prepare_jax", lambda: None)  # tests/conftest.py has done it

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["difffric", *map(str, arguments)])
        out = StringIO()
        catch = nullcontext() if capture else redirect_stdout(out)
        with pytest.raises(SystemExit) as stop, catch:
            main.main()
        said = capture.readouterr() if capture else (out.getvalue(), "")
        return Done(int(stop.value.code or 0), *said)

    return run


def _answer(folder: Path) -> dict:
    def refuse(word):
        raise AssertionError(f"{word} in result.json")

    return json.loads((folder / "result.json").read_text(), parse_constant=refuse)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> dict[str, Path]:
    """Folders: fits of the recordings and of the table, which has every extra, what both said
    on the console beside them; the table identified with its own fit."""
    with pytest.MonkeyPatch.context() as patch:
        run = _runner(patch)
        folders = {x: tmp_path_factory.mktemp(x) / "new" / "fit" for x in ("tdms", "csv")}
        plain = run("fit", TDMS, "--setup", SETUP, "--out", folders["tdms"], "--quiet")
        more = ("--profile", "--next-push", "--out", folders["csv"], "--quiet")
        extra = run("fit", CSV, "--setup", SETUP, *more)
        assert plain.code == extra.code == 0
        for kind, done in (("tdms", plain), ("csv", extra)):
            (folders[kind].parent / "said").write_text(done.out)
        folders["identified"] = tmp_path_factory.mktemp("identified") / "out"
        with_it = ("--setup", folders["csv"] / "setup.toml", "--out", folders["identified"])
        assert run("identify", CSV, *with_it, "--quiet").code == 0
    return folders


# What a fit writes


@pytest.mark.parametrize("kind", ["tdms", "csv"])
def test_the_parameters_are_within_three_standard_errors_of_the_truth(fitted, kind):
    answer = _answer(fitted[kind])
    assert answer["converged"] is True and answer["not_identifiable"] == []
    dry, oily = TRUTH["rigs"]["DRY"], TRUTH["rigs"]["OILY"]
    truth = {x: dry[x] for x in ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m")}
    truth |= {"mu_s[DRY]": dry["mu_s"], "mu_s[OILY]": oily["mu_s"]}
    assert set(answer["parameters"]) == set(truth)
    for name, value in truth.items():
        found = answer["parameters"][name]
        assert abs(found["value"] - value) < 3 * found["standard_error"], name
        low, high = found["interval_95"]
        assert low < found["value"] < high
    scatter = answer["mu_s_scatter"]
    assert abs(scatter["value"] - dry["mu_s_scatter"]) < 3 * scatter["standard_error"]


@pytest.mark.parametrize("kind", ["tdms", "csv"])
def test_each_push_has_its_own_mu_s_and_its_measurements(fitted, kind):
    pushes = _answer(fitted[kind])["pushes"]
    assert len(pushes) == len(TRUTH["pushes"])
    for push, true in zip(pushes, TRUTH["pushes"], strict=True):
        own = push["mu_s"]
        assert abs(own["value"] - true["mu_s"]) < 4 * own["standard_error"]
        assert push["velocity_m_per_s"] == pytest.approx(true["velocity_mm_min"] / 60e3)
        assert push["condition"] == true["condition"]
        F, error = push["measured_peak_force_N"], push["measured_peak_force_se_N"]
        assert abs(F - true["peak_contact_force_N"]) < 4 * error


def test_residuals_are_standard_normal_where_the_model_is_right(fitted):
    for kind in ("tdms", "csv"):
        pushes = _answer(fitted[kind])["pushes"]
        r = np.array([x["residual_peak_force_sigma"] for x in pushes])
        assert 0.3 < np.mean(r**2) < 2.2  # 14 numbers: chi-square's 0.1 and 99.9 % points
    chi2 = [x["trace_reduced_chi2"] for x in _answer(fitted["tdms"])["pushes"]]
    assert np.allclose(chi2, 1.0, atol=0.15)


def test_correlations_stand_once_for_each_pair(fitted):
    answer = _answer(fitted["csv"])
    names = list(answer["parameters"])
    pairs = [(a, b) for a, row in answer["correlation"].items() for b in row]
    assert pairs == [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    assert all(abs(c) <= 1 for row in answer["correlation"].values() for c in row.values())


def test_extras_are_written_where_they_are_asked_for(fitted):
    plain, more = _answer(fitted["tdms"]), _answer(fitted["csv"])
    assert plain["profiles"] is None and plain["next_push"] is None
    assert set(more["profiles"]) == set(more["parameters"])
    before, after = (more["next_push"][f"standard_error_{x}"] for x in ("before", "after"))
    assert all(after[x] < before[x] for x in before)


def test_the_next_push_is_said_where_it_is_typed(fitted):
    """On the console, not in the report alone: speed, mass and condition."""
    best = _answer(fitted["csv"])["next_push"]
    said = " ".join((fitted["csv"].parent / "said").read_text().split())
    speed = f"{60e3 * best['velocity_m_per_s']:.0f} mm/min"
    words = f"Make a push of {best['condition']} at {speed} with {best['mass_kg']:.4g} kg"
    assert f"Next: {words}: it tells most" in said
    plain = (fitted["tdms"].parent / "said").read_text()
    fitted_setup = fitted["tdms"] / "setup.toml"
    assert "Make a push" not in plain
    assert plain.endswith(f"with it.\n  difffric identify {TDMS} --setup {fitted_setup}\n")
    assert "next:" not in plain


def test_the_folder_holds_the_page_the_figures_and_the_set_up(fitted):
    always = {"result.json", "report.html", "setup.toml", "pushes.png", "mu_s.png"}
    always |= {"correlations.png"}
    assert {p.name for p in fitted["tdms"].iterdir()} == always | {"traces.png"}
    assert {p.name for p in fitted["csv"].iterdir()} == always | {"profiles.png"}
    page = (fitted["tdms"] / "report.html").read_text()
    assert page.count("<figure>") == page.count("<svg") == 4
    assert "http://" not in page and "https://" not in page


# Answers that are none


@pytest.mark.parametrize(
    ("scatter_free", "says"),
    [
        # Minutes: nonsense has many optima, and each is looked at.
        pytest.param(True, "a scatter of mu_s of", marks=pytest.mark.slow),
        (False, "starts reached the best"),
    ],
)
def test_distances_of_other_pushes_do_not_converge(scatter_free, says):
    """With d exchanged between slow and fast pushes the search settles, on nonsense: mu_s
    scatters without measure, or, where it may not, few starts end on the best of the misfits."""
    rig = read_setup(SETUP).rig
    v = np.repeat([0.01, 0.02, 0.04, 0.08], 2)
    seen = [df.observe(rig, x) for x in v]
    F, d = (
        np.array([float(getattr(x, q)) for x in seen]) for q in ("peak_force", "sliding_distance")
    )
    errors = {"peak_force_se": np.full(8, 0.5), "sliding_distance_se": np.full(8, 4e-7)}
    held = {"friction.mu_s_scatter": Extras(free=scatter_free)}
    setup = Setup(rig, mu_s_scatter=0.02, extras=held)

    def fit(order):
        return df.fit(setup, df.Pushes(v, F, d[order], **errors))

    wrong = fit([0, 7, 2, 5, 4, 3, 6, 1])
    assert wrong.state.at.settled and not wrong.converged
    (note,) = [x for x in wrong.notes if says in x]
    assert note.startswith("not converged")
    right = fit(np.arange(8))
    assert right.converged and not any("not converged" in x for x in right.notes)


# The fitted set-up goes into identify


def test_the_fitted_set_up_holds_the_fitted_values_and_their_errors(fitted):
    setup, answer = read_setup(fitted["csv"] / "setup.toml"), _answer(fitted["csv"])
    for name, value in (("k_N_per_m", setup.rig.contact.k), ("b_N_s_per_m", setup.rig.contact.b)):
        assert value == answer["parameters"][name]["value"]
        assert setup.extras[name].standard_error == answer["parameters"][name]["standard_error"]
    assert setup.mu_s_scatter == answer["mu_s_scatter"]["value"]


def test_identify_with_the_fitted_set_up_finds_every_push(fitted):
    out = fitted["identified"]
    answer = _answer(out)
    for push, true in zip(answer["pushes"], TRUTH["pushes"], strict=True):
        assert push["regime"] == true["regime"] and push["reason"] is None
        assert sum(push["weights"].values()) == pytest.approx(1)
        for way in ("mu_s_force", "mu_s_distance", "mu_s_weighted", "mu_s_optimal"):
            found = push[way]
            assert abs(found["value"] - true["mu_s"]) < 3 * found["standard_error"], way
        assert push["mu_s_trace"] is None and push["mu_s_slide"] is None
        assert push["alternatives"] == [] or push["mu_s_distance"]["value"] in push["alternatives"]
    assert set(answer["conditions"]) == {"DRY", "OILY"}
    for condition, of in answer["conditions"].items():
        true = np.mean([x["mu_s"] for x in TRUTH["pushes"] if x["condition"] == condition])
        assert abs(of["mean"] - true) < 3 * of["standard_error"] and of["pushes"] == 7
    assert {p.name for p in out.iterdir()} == {
        "result.json", "report.html", "mu_s.png", "mu_s_ways.png",
    }  # fmt: skip


def test_the_set_up_s_standard_errors_are_carried(fitted, run, tmp_path):
    text = (fitted["csv"] / "setup.toml").read_text()
    sure = tmp_path / "sure.toml"
    sure.write_text(re.sub(r"standard_error = [0-9.e+-]+, ", "", text))
    assert run("identify", CSV, "--setup", sure, "--out", tmp_path / "sure").code == 0
    errors = {}
    for name, folder in (("sure", tmp_path / "sure"), ("fitted", fitted["identified"])):
        pushes = _answer(folder)["pushes"]
        errors[name] = np.array([x["mu_s_distance"]["standard_error"] for x in pushes])
    assert (errors["fitted"] > 1.1 * errors["sure"]).all()


def test_recordings_are_identified_from_all_their_samples(fitted, run, tmp_path):
    setup = fitted["tdms"] / "setup.toml"
    assert run("identify", TDMS, "--setup", setup, "--out", tmp_path / "out").code == 0
    for push, true in zip(_answer(tmp_path / "out")["pushes"], TRUTH["pushes"], strict=True):
        found = push["mu_s_trace"]
        assert abs(found["value"] - true["mu_s"]) < 4 * found["standard_error"]
        assert found["standard_error"] < push["mu_s_optimal"]["standard_error"]
        assert push["trace_reduced_chi2"] == pytest.approx(1, abs=0.15)


def test_free_slides_alone(run, tmp_path):
    slides, setup = EXAMPLES / "slides.csv", tmp_path / "fit" / "setup.toml"
    fit = run("fit", slides, "--setup", SETUP, "--out", tmp_path / "fit", "--quiet")
    assert fit.code == 0 and "40 free slides" in fit.out
    parameters = _answer(tmp_path / "fit")["parameters"]
    assert set(parameters) == {"k_v_N_s_per_m", "mu_s[DRY]", "mu_s[OILY]"}
    done = run("identify", slides, "--setup", setup, "--out", tmp_path / "answer", "--quiet")
    assert done.code == 0
    pushes = _answer(tmp_path / "answer")["pushes"]
    found = np.array(
        [(x["mu_s_slide"]["value"], x["mu_s_slide"]["standard_error"]) for x in pushes]
    )
    assert (np.abs(found[:, 0] - TRUTH["slides"]["mu_s"]) < 4 * found[:, 1]).all()
    assert pushes[0]["velocity_m_per_s"] is None and pushes[0]["mu_s_force"] is None


# The summary of identify


def _push(value, error, condition="", shared=()):
    best = NONE if value is None else Estimate(value, error, shared)
    return PushFriction(0.05, condition, None, best, NONE, NONE, best, None, (), None, None)


def test_the_mean_weighs_pushes_by_error_and_spread():
    value, error = np.array([0.10, 0.12, 0.11]), np.array([0.001, 0.05, 0.002])
    found = Identified(tuple(_push(*x) for x in zip(value, error, strict=True)))
    of = summarise_conditions(found)[""]
    w = 1 / (error**2 + 0.01**2)
    assert of["mean"] == pytest.approx(w @ value / w.sum())
    assert of["spread"] == pytest.approx(0.01 / of["mean"])


def test_the_mean_of_equal_pushes_has_the_textbook_error():
    found = Identified(tuple(_push(x, None, "A") for x in (0.10, 0.12, 0.14, 0.16)))
    of = summarise_conditions(found)["A"]
    assert of["mean"] == pytest.approx(0.13)
    assert of["standard_error"] == pytest.approx(np.std([0.10, 0.12, 0.14, 0.16], ddof=1) / 2)


def test_one_push_and_none_have_no_spread():
    of = summarise_conditions(Identified((_push(0.1, 0.002, "A"), _push(None, None, "B"))))
    one, none = (
        {"standard_error": se, "calibration_standard_error": shared, "spread": None}
        for se, shared in ((0.002, 0.0), (None, None))
    )
    assert of["A"] == {"pushes": 1, "mean": 0.1, **one}
    assert of["B"] == {"pushes": 0, "mean": None, **none}


def test_an_error_that_all_pushes_share_does_not_average_out():
    def error(*shared):
        found = (
            _push(x, None, "A", s) for x, s in zip((0.10, 0.12, 0.14, 0.16), shared, strict=True)
        )
        return summarise_conditions(Identified(tuple(found)))["A"]["standard_error"]

    between = np.std([0.10, 0.12, 0.14, 0.16], ddof=1) / 2
    assert error(*4 * [(0.03, 0.04)]) == pytest.approx(np.hypot(between, 0.05))
    assert error((0.05,), (-0.05,), (0.05,), (-0.05,)) == pytest.approx(between)
    assert error((0.06, 0.0), (0.0, 0.06), (0.06, 0.0), (0.0, 0.06)) == pytest.approx(
        np.hypot(between, 0.06 / np.sqrt(2))
    )


@pytest.mark.parametrize(
    ("name", "error"), [("k_N_per_m", 8e3), ("b_N_s_per_m", 15.0), ("k_v_N_s_per_m", 0.5)]
)
def test_the_shared_error_is_the_mean_s_shift_with_the_calibration(name, error):
    """One standard error of a parameter moves the mean of exact pushes by its shared error."""
    rig = read_setup(SETUP).rig
    v = np.array([0.02, 0.03, 0.05, 0.06, 0.08])
    seen = [df.observe(rig, x) for x in v]
    F, d = (
        np.array([float(getattr(x, q)) for x in seen]) for q in ("peak_force", "sliding_distance")
    )
    pushes = df.Pushes(v, F, d, peak_force_se=np.full(5, 0.3), sliding_distance_se=np.full(5, 2e-7))
    value = float(parameters.values(rig)[name])

    def mean(shift, **known):
        at = parameters.with_values(rig, {name: value + shift * error})
        return summarise_conditions(df.identify(Setup(at, **known), pushes))[""]

    said, up, down = (
        mean(x, extras={name: Extras(standard_error=error)}) for x in (0.0, 0.01, -0.01)
    )
    shift = abs(up["mean"] - down["mean"]) / 0.02
    assert said["calibration_standard_error"] == pytest.approx(shift, rel=1e-3)
    assert said["standard_error"] == pytest.approx(said["calibration_standard_error"])
    assert mean(0.0)["calibration_standard_error"] == 0


def test_the_shared_error_of_free_slides_is_their_mean_s_shift_with_viscosity():
    setup, slides = read_setup(SETUP), df.load(EXAMPLES / "slides.csv")
    k_v, error = float(setup.rig.friction.k_v), 0.5

    def means(shift, **known):
        at = parameters.with_values(setup.rig, {"k_v_N_s_per_m": k_v + shift * error})
        return summarise_conditions(df.identify(Setup(at, **known), slides))

    extras = {"k_v_N_s_per_m": Extras(standard_error=error)}
    said, up, down = (means(x, extras=extras) for x in (0.0, 0.01, -0.01))
    for condition, of in said.items():
        shift = abs(up[condition]["mean"] - down[condition]["mean"]) / 0.02
        assert of["calibration_standard_error"] == pytest.approx(shift, rel=0.02)
        assert of["standard_error"] > of["calibration_standard_error"] > 0


# Bad input: one line, exit status 2, nothing left behind


def _without_contact(path: Path) -> None:
    """The examples' recordings, in the second of which nothing was touched."""
    recordings = df.load(TDMS)
    second = recordings[1]
    noise = 0.5 * np.random.default_rng(0).standard_normal(second.force.n)
    silent = Channel.of(noise, second.force.dt, second.force.start, "N")
    pushes = (recordings[0], replace(second, force=silent), *recordings[2:])
    write_recordings(replace(recordings, pushes=pushes), path)


def _bad(kind: str, folder: Path) -> tuple[Path, Path]:
    """(data, set-up), one of which is bad."""
    data, setup = folder / "pushes.csv", folder / "setup.toml"
    setup.write_text(SETUP.read_text())
    table = CSV.read_text()
    if kind == "no set-up":
        return CSV, folder / "none.toml"
    if kind == "no data":
        return folder / "none.tdms", setup
    if kind == "suffix":
        data = folder / "pushes.ods"
        data.write_text(table)
    elif kind == "no column":
        data.write_text("".join(row.partition(",")[2] for row in table.splitlines(True)))
    elif kind == "decimal comma":
        data.write_text(table.replace("122.188", '"122,188"'))
    elif kind == "other mass":
        data.write_text(table.replace("18.9", "17.0", 1))
    elif kind == "truncated":
        data = folder / "pushes.tdms"
        data.write_bytes(TDMS.read_bytes()[:200_001])
    elif kind == "no contact":
        data = folder / "pushes.tdms"
        _without_contact(data)
    elif kind == "no push":
        data.write_text(table.splitlines()[0] + "\n")
    return data, setup


@pytest.mark.parametrize("command", ["fit", "identify"])
@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("no set-up", ("none.toml", "no such file")),
        ("no data", ("none.tdms", "no such file")),
        ("suffix", ("pushes.ods", "expected", ".csv", ".tdms")),
        ("no column", ("pushes.csv", "velocity_mm_min")),
        ("decimal comma", ("pushes.csv", "line 2", "122,188")),
        ("other mass", ("push 1 of 14", "18.9 kg", "17 kg", "--use-data-mass")),
        ("truncated", ("pushes.tdms: damaged", "push 0009", "200001")),
        ("no contact", ("pushes.tdms", "push 0002", "without contact")),
        ("no push", ("pushes.csv",)),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(run, tmp_path, command, kind, words):
    data, setup = _bad(kind, tmp_path)
    out = tmp_path / "a" / "b"
    done = run(command, data, "--setup", setup, "--out", out, "--quiet")
    assert done.code == 2 and done.out == ""
    assert done.err.startswith("difffric: ")
    assert not (tmp_path / "a").exists()
    assert all(word in done.err for word in words), done.err
    problems = 2 if kind == "truncated" else 1  # the file's, and the group's that it cuts
    assert len(done.err.strip().splitlines()) == problems, done.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("Missing argument",)),
        ((CSV,), ("--setup is missing", f"difffric init {CSV} writes one")),
        ((CSV, "--setup", SETUP, "--bogus"), ("--bogus",)),
        ((CSV, "--setup", SETUP, "--free", "k"), ("no such parameter: k", "k_N_per_m")),
        ((CSV, "--setup", SETUP, "--free", "mass_kg"), ("mass_kg", "said by the data")),
        ((CSV, "--setup", SETUP, "--free-start"), ("only recordings",)),
        ((TDMS, "--setup", SETUP, "--robust"), ("--robust", "expected a table")),
    ],
)
def test_bad_options_are_one_line(run, arguments, words):
    done = run("fit", *arguments, *["--quiet"] * bool(arguments))
    assert done.code == 2 and len(done.err.strip().splitlines()) == 1
    assert all(word in done.err for word in words), done.err


def test_a_fit_does_not_replace_the_set_up_it_starts_from(run, tmp_path):
    setup = tmp_path / "setup.toml"
    setup.write_text(SETUP.read_text())
    done = run("fit", CSV, "--setup", setup, "--out", tmp_path)
    assert done.code == 2 and "another folder" in done.err
    assert setup.read_text() == SETUP.read_text() and len(list(tmp_path.iterdir())) == 1


def test_what_is_skipped_is_counted_and_told(run, tmp_path):
    data, out = tmp_path / "pushes.tdms", tmp_path / "out"
    _without_contact(data)
    done = run("fit", data, "--setup", SETUP, "--skip-bad", "--out", out, "--quiet")
    assert done.code == 0 and "Skipped: 1" in done.out
    answer = _answer(out)
    assert len(answer["pushes"]) == 13 and "push 0002" not in [x["name"] for x in answer["pushes"]]
    assert len(answer["skipped"]) == 1 and "push 0002" in answer["skipped"][0]
    assert "push 0002" in (out / "report.html").read_text()


def test_bad_rows_of_a_table_are_skipped(run, tmp_path):
    data, out = tmp_path / "pushes.csv", tmp_path / "out"
    data.write_text(CSV.read_text().replace("122.188", '"122,188"'))
    done = run("identify", data, "--setup", SETUP, "--skip-bad", "--out", out, "--quiet")
    assert done.code == 0 and "Skipped: 1" in done.out
    assert len(_answer(out)["pushes"]) == 13


def test_the_data_s_mass_is_used_where_that_is_asked_for(run, tmp_path):
    setup = tmp_path / "setup.toml"
    setup.write_text(SETUP.read_text().replace("mass_kg = 18.9", "mass_kg = 17.0"))
    options = ("--use-data-mass", "--out", tmp_path / "out", "--quiet")
    assert run("fit", CSV, "--setup", setup, *options).code == 0
    k = _answer(tmp_path / "out")["parameters"]["k_N_per_m"]
    true = TRUTH["rigs"]["DRY"]["k_N_per_m"]
    assert abs(k["value"] - true) < 3 * k["standard_error"]
