"""A study of diagnosis: random rigs with hidden effects, from files, started from rough set-ups.

    python -m studies.diagnosis [--only clean] [--cases 50] [--shard 1/2] [--results DIR]
        [--rounds 50] [--page PAGE] [--keep]

Every case has a seed of its own, is made by `tests.hidden`, which shares no code with the library,
written to files, diagnosed from them, and appended as a line of JSON to
DIR/diagnosis/CODE/GROUP.jsonl. What is there already is not done again, nor what an earlier run
kept with the source (`--keep`). With `--rounds` the parts take turns, so that a study that is
stopped has some of each. `studies.diagnosis_figures` makes the figures, and
`studies.diagnosis_targets` holds them against what was asked.
"""

from __future__ import annotations

import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from studies import diagnosis_figures as figures
from studies import diagnosis_misses as misses
from studies import diagnosis_targets as targets
from studies import reliability, runs
from tests.hidden import case as cases
from tests.hidden import friction_of, random_case, strength, with_nuisances, write
from tests.hidden.outsiders import TABLE as OUTSIDERS
from tests.hidden.scaling import with_misfit
from tests.reference.effect_parameters import NULLS

PAGE = runs.ROOT / "docs" / "study.md"
IMAGE = runs.ROOT / "docs" / "images" / "diagnosis_confusion.png"
RELIABILITY = IMAGE.with_name("diagnosis_reliability.png")
ROOMS = ("calibration", "compute", "diagnosis", "estimation", "measurements", "rig", "simulation")
"""Packages of the library on which a diagnosis depends."""
EFFECTS = tuple(NULLS)
AT_NO_STRENGTH = ("normal_force", "pusher_duration")
"""A normal force needs a second mass to be seen; a duration has no small size: it begins to show
where it cuts a push short, all at once."""
IN_RECORDINGS = tuple(e for e in EFFECTS if e not in (*cases.TABLE_ONLY, *AT_NO_STRENGTH))
TIMING = ("pusher_ripple", "force_lowpass", "force_highpass", "channel_skew", "presliding")
IN_TABLES = tuple(e for e in EFFECTS if e not in TIMING)
"""those that F_p and d show"""
_NINETY_FIVE = 1.96
"""Standard errors of a 95 % interval."""
LONGEST_MAKING = 100.0
"""Seconds after which a case is given up that is being made: scaling some rigs with bristles, or
that chatter, takes ten minutes."""
HEAVIER = (1.0, 1.3)
"""Relative masses where a normal force is looked for."""


@dataclass(frozen=True)
class Group:
    """One part of the study: what is hidden in its cases."""

    seed: int
    count: int
    make: Callable
    """(case number, seed) -> case"""
    matters: float = 0.0
    """the share of mu_s from which on a cause counts: everything, but beside small ones of all
    effects"""


def _turn(names: Sequence, i: int):
    return names[i % len(names)]


def _strong(strength: float, kind: str = cases.RECORDINGS, among=IN_RECORDINGS, n=14) -> Callable:
    def make(i, seed):
        effect = _turn(among, i)
        more = {"masses": HEAVIER} if effect == "normal_force" else {}
        more["n"] = n
        if effect == "stribeck" and (i // len(among)) % 2:
            more["delta"] = 1.0
        if effect == "pusher_ramp" and (i // len(among)) % 2:
            more["s_curve"] = True
        return random_case(seed, effect, strength, kind=kind, **more)

    return make


def _counts(i, seed):
    """An effect that changes F_p or d by 3 % and more, among small ones of every other."""
    share = 0.03 * 4 ** np.random.default_rng(seed).uniform()
    return random_case(seed, _turn(IN_RECORDINGS, i), change=share, nuisances=True)


def _strong_misfit(i, seed):
    """An effect that moves the samples by 10 to 100 times the noise."""
    effect, times = _turn(IN_RECORDINGS, i), 10 ** np.random.default_rng(seed).uniform(1, 2)
    for attempt in range(20):
        with suppress(ValueError):
            return with_misfit(random_case(seed + 1000 * attempt, effect), effect, times)
    raise ValueError(f"no rig shows {effect} so strongly")


def _pair(i, seed):
    rng = np.random.default_rng([seed, 7])
    names = [e for e in IN_RECORDINGS if e != "presliding"]
    for attempt in range(20):
        pair = rng.choice(len(names), 2, replace=False)
        try:
            return random_case(seed + attempt, [names[k] for k in pair], strength=30.0)
        except ValueError:  # inseparable, or not to be scaled to that
            continue
    raise ValueError("no pair")


def _outsider(i, seed):
    return random_case(seed, _turn(tuple(OUTSIDERS), i), strength=40.0)


def _background(i, seed, share=0.0035, change: float | None = None, among=IN_RECORDINGS):
    """An effect, or none, among small ones of every other."""
    effect = None if change is None else _turn(among, i)
    for attempt in range(20):
        with suppress(ValueError):
            own = seed + 1_000_000 * attempt
            case = random_case(own, effect, change=change)
            return with_nuisances(case, np.random.default_rng([own, 5]), share)
    raise ValueError(f"no rig shows {effect} so")


GROUPS = {
    "clean": Group(1, 1000, lambda i, seed: random_case(seed)),
    "clean tables": Group(2, 100, lambda i, seed: random_case(seed, kind=cases.TABLE, n=24)),
    "s = 6": Group(3, 240, _strong(6.0)),
    "s = 10": Group(4, 240, _strong(10.0)),
    "s = 30": Group(5, 60, _strong(30.0)),
    "typical": Group(6, 120, lambda i, seed: random_case(seed, _turn(IN_RECORDINGS, i))),
    "tables of 24": Group(7, 160, _strong(10.0, cases.TABLE, IN_TABLES, 24)),
    "tables of 100": Group(17, 40, _strong(10.0, cases.TABLE, IN_TABLES, 100)),
    "with nuisances": Group(8, 30, _counts, 0.005),
    "pairs": Group(9, 200, _pair),
    "outsiders": Group(10, 150, _outsider),
    "strong": Group(11, 30, _strong_misfit, 0.005),
    "background": Group(12, 1000, _background, 0.005),
    "background, 3 %": Group(13, 100, partial(_background, change=0.03), 0.005),
    "background, 1 %": Group(14, 100, partial(_background, change=0.01), 0.005),
    "three times, 3 %": Group(15, 100, partial(_background, share=0.0105, change=0.03), 0.005),
    "outsiders, background": Group(
        18, 24, partial(_background, change=0.03, among=tuple(OUTSIDERS)), 0.005
    ),
    "s = 4": Group(16, 240, _strong(4.0)),
}


def run_case(group: str, i: int, keep: Path | None = None) -> dict:
    """One case: what was hidden, what the diagnosis says, and what the true model would gain."""
    import difffric as df
    from difffric.rig.setup_toml import read_setup

    line: dict = {"group": group, "case": i}
    with tempfile.TemporaryDirectory() as empty:
        folder = keep or Path(empty)
        try:
            with limit_time(LONGEST_MAKING):
                case = GROUPS[group].make(i, 100_000 * GROUPS[group].seed + i)
                s = strength(case) if case.hidden else 0.0
                path = write(case, folder)
        except (ValueError, TimeoutError) as error:
            return {**line, "skipped": str(error)}
        line |= {"kind": case.kind, "effects": dict(case.effects), "outsider": dict(case.outsider)}
        line["another_form"] = case.s_curve or _exponent(case) != 2.0
        line |= {"components": list(case.components), "s": s}
        setup, data = read_setup(folder / "setup.toml"), df.load(path)
        began = time.perf_counter()
        try:
            heavier, matters = len(case.masses) > 1, GROUPS[group].matters
            found = df.diagnose(setup, data, use_data_mass=heavier, matters=matters)
        except (df.DifffricError, ArithmeticError, ValueError) as error:
            return {**line, "error": f"{type(error).__name__}: {error}"}
        line["seconds"] = time.perf_counter() - began
    told = found.as_dict()
    told.pop("experiments")
    truth = _find_friction(case)
    away = np.abs(np.array(told.pop("mu_s")) - truth)
    within = float(np.mean(away <= _NINETY_FIVE * np.array(told.pop("mu_s_standard_error"))))
    line |= {"mu_s_within": within, "mu_s_error": _measure_error(away / truth)}
    # Beside small effects of every kind it is no true model that has the one cause alone.
    true = None if case.nuisances else true_model(found, case)
    return {**line, **told, "true_model": true}


@contextmanager
def limit_time(seconds: float) -> Iterator[None]:
    """Raise `TimeoutError` where what is within takes longer."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"takes longer than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    except SystemError as error:  # a compiled function may not pass on what was raised in it
        if not any(isinstance(x, TimeoutError) for x in _list_causes(error)):
            raise
        raise TimeoutError(f"takes longer than {seconds:g} s") from error
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _list_causes(error: BaseException) -> Iterator[BaseException]:
    """What an error was raised from, and so on."""
    while error.__cause__ is not None:
        error = error.__cause__
        yield error


def _find_friction(case: cases.Case) -> np.ndarray:
    """The friction of each push that F_p and d show: what static friction grows by in a rest is in
    it where that is the cause that was hidden."""
    seen = {name: x for name, x in case.nuisances.items() if name != "static_dwell"}
    return friction_of(replace(case, nuisances=seen))


def _measure_error(away: np.ndarray) -> float:
    """The root mean square of some relative errors."""
    return float(np.sqrt(np.mean(away**2)))


def _exponent(case: cases.Case) -> float:
    return case.effects.get("stribeck", {}).get("delta", 2.0)


def true_model(found, case: cases.Case) -> dict | None:
    """The error on held-out pushes of the model that made the data, fitted from the truth, by how
    much it beats the diagnosis's own in -2 log likelihood, how probable it is that chance beats
    the plain model by as much as it does, and the error of its mu_s. None: not one of the
    catalogue's, or not to be followed."""
    from difffric.diagnosis.cross_validation import assign_folds
    from difffric.diagnosis.score_test import compute_p_value
    from difffric.estimation.ensembles import ensemble as en
    from difffric.estimation.ensembles import ensemble_refits, held_out
    from difffric.rig.catalogue import numbers_of

    state = found.state
    plain, base, task = state.plain, state.extended, state.data.task
    coordinates = task.model.coordinates
    names = [name for effect in case.effects for name in numbers_of(effect)]
    if case.outsider or not names or not set(names) <= set(coordinates.names):
        return None
    values = {**case.rig, "mu_s": 1.0}
    for effect, numbers in case.effects.items():
        values |= {
            "mu_k_over_mu_s" if effect == "friction_ratio" else f"{effect}.{key}": x
            for key, x in numbers.items()
        }
    c = plain.c.copy()
    known = [x for x in dict.fromkeys((*case.rig, *names)) if x in coordinates.names]
    c[0, coordinates.indices(known)] = coordinates.point({name: values[name] for name in known})
    own = np.log([push.mu_s for push in case.pushes])
    mu = np.array([[own[task.condition == k].mean() for k in range(task.conditions)]])
    extra = (*plain.extra[0], *(i for i in coordinates.indices(names) if i not in task.shared))
    at = replace(
        plain, extra=(extra,), c=c, mu=mu, own=own[None] - mu[:, task.condition],
        gram=None, residual=None, damping=None,
    )  # fmt: skip
    at = en.evaluate(task, at)
    if (en.sum_squares(task, at) >= en.REJECTED).any():  # bristles too stiff to be followed
        return None
    at = ensemble_refits.refit(task, at, 30)
    folds = assign_folds(np.asarray(task.model.pushes.velocity), False)
    drop = float(en.criterion(task, plain)[0] - en.criterion(task, at)[0])
    effect, looked_for = next(iter(case.effects)), len(state.data.looked_for)
    squares = held_out.predict_held_out(task, replace(at, spread=base.spread), folds).squares
    mu_s = np.exp(at.mu[0, task.condition] + at.own[0])
    return {
        "mu_s_error": _measure_error(mu_s / _find_friction(case) - 1),
        "heldout_nrmse": float(np.sqrt(squares.sum() / task.counts.sum())),
        "better_by": float(en.criterion(task, base)[0] - en.criterion(task, at)[0]),
        "p_value": compute_p_value(effect, drop, looked_for),
    }


_READ = (
    "group", "case", "kind", "skipped", "error", "effects", "outsider", "another_form",
    "components", "s", "seconds", "verdict", "location", "remaining", "gain", "true_model",
    "mu_s_within", "mu_s_error",
)  # fmt: skip
_OF_CAUSES = (
    "id", "component", "confusable_with", "probability", "parameters", "chi2_drop",
    "chi2_drop_predicted",
)  # fmt: skip
"""What the figures read of a case and of its causes."""


def shorten(line: dict) -> dict:
    """A case with what the figures read, to five digits."""
    short = {key: line[key] for key in _READ if key in line}
    for key in ("causes", "considered", "negligible"):
        if key in line:
            some = [x for x in line[key] if key != "considered" or x["id"] in line["effects"]]
            short[key] = [{k: x[k] for k in _OF_CAUSES if k in x} for x in some]
    return _round(short)


def _round(x):
    """All numbers within to five digits."""
    if isinstance(x, dict):
        return {key: _round(value) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [_round(value) for value in x]
    return float(f"{x:.5g}") if isinstance(x, float) else x


def main(words: Sequence[str] | None = None) -> int:
    """Run what is missing, print the figures, write the page."""
    asked, shard = runs.arguments("studies.diagnosis", __doc__ or "", tuple(GROUPS), PAGE, words)
    runs.prepare(shard)
    name = runs.code("hidden", ROOMS)
    folder, kept = asked.results / "diagnosis" / name, runs.KEPT / "diagnosis" / name
    runs.add_missing(kept, folder)
    sizes = {
        group: GROUPS[group].count if asked.cases is None else asked.cases
        for group in asked.only or GROUPS
    }
    for group, number in runs.take_turns(sizes, asked.rounds):
        runs.run(group, folder, number, partial(run_case, group), shard, figures.told)
    everything = {group: runs.load(folder, group) for group in GROUPS}
    if asked.keep:
        runs.add_missing(folder, kept, shorten)
    counted = targets.count_cases(everything, {group: GROUPS[group].count for group in GROUPS})
    head = f"Measured with source `{name}`: {counted} of the cases."
    tables = targets.tabulate(everything), figures.markdown(everything)
    text = "\n\n".join(x for x in (head, *tables, misses.markdown(everything)) if x)
    print(text)
    if shard == (1, 1):
        figures.confusion(everything, IMAGE)
        reliability.draw(targets.list_rated(everything), RELIABILITY)
        runs.write_into(asked.page, text, "diagnoses")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
