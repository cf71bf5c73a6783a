"""A study of calibration: random rigs, simulated apart from the library, fitted from rough starts.

    python -m tests.study [--only tables] [--cases 100] [--shard 1/2] [--results DIR] [--page PAGE]

Every case draws a rig, its pushes, their noise and a rough guess from a seed of its own, fits
from the guess, settles once more from the truth, and appends a line of JSON to DIR/CODE/KIND.jsonl
(CODE stands for the library's source, so that no figure mixes two versions). What is there already
is not done again. The figures are printed, and set between two marks of the page.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests import study_figures as figures
from tests.reference import data as reference

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / ".study"
PAGE = ROOT / "docs" / "study.md"
START, END = "<!-- study:start -->", "<!-- study:end -->"
SENSOR_RANGE = 5000.0
"""[N]: no rig of the study saturates its sensor"""
LEAST_SCATTER = 1e-4
"""From no scatter a fit would not find one."""
SPREADS = ("peak_force_se", "sliding_distance_se")


@dataclass(frozen=True)
class Kind:
    """One part of the study: how its data are made, and how many cases it has."""

    seed: int
    cases: int
    data: Callable


def table(pushes, rng, without: Sequence[str] = ()):
    """F_p and d with normal errors of 0.5 N and 0.3 µm, of which the fit knows or not."""
    import difffric as df

    columns = reference.measure(pushes, rng)
    return df.Pushes(**{name: x for name, x in columns.items() if name not in without})


def recordings(pushes, rng, rho: float = 0.0):
    """Force and position at 10 kHz with noise of 0.5 N and 0.3 µm, AR(1) where rho is not 0."""
    from difffric.recordings import Channel, Recording, Recordings

    found = []
    for push in pushes:
        x = reference.record(push, rng, noise=reference.Noise(rho=rho))
        found.append(
            Recording(
                velocity=push.velocity,
                force=Channel.of(x.force, x.dt, x.start, "N"),
                position=Channel.of(x.position, x.dt, x.start, "m"),
                stroke=math.nan if push.stroke is None else push.stroke,
                order=float(push.order),
            )
        )
    return Recordings(tuple(found))


KINDS = {
    "tables": Kind(1, 1000, table),
    "recordings": Kind(2, 300, recordings),
    "correlated": Kind(3, 300, lambda pushes, rng: recordings(pushes, rng, rho=0.9)),
    "spreads": Kind(4, 200, lambda pushes, rng: table(pushes, rng, SPREADS)),
}


def draw(kind: str, case: int):
    """(rig, guess, pushes, data) of one case."""
    rng = np.random.default_rng([KINDS[kind].seed, case])
    rig = reference.random_rig(rng)
    guess = reference.rough_guess(rig, rng)
    pushes = reference.make_pushes(rig, rng)
    return rig, guess, pushes, KINDS[kind].data(pushes, rng)


def as_library(rig: reference.Rig):
    """The rig as the library's own."""
    import difffric as df
    from difffric.sensors import ForceSensor

    return df.spring_damper_rig(
        mass=rig.m, mu_s=rig.mu_s, k=rig.k, b=rig.b, k_v=rig.k_v, mu_k_over_mu_s=rig.ratio,
        force_sensor=ForceSensor(range=SENSOR_RANGE),
    )  # fmt: skip


def true_values(rig: reference.Rig) -> dict[str, float]:
    """Label -> value [SI]."""
    found = zip(figures.LABELS, (rig.k, rig.b, rig.k_v, rig.mu_s), strict=True)
    return dict(found)


def run_case(kind: str, case: int) -> dict:
    """One case: what the fit found, and whether a fit from the truth finds better."""
    import difffric as df

    rig, guess, pushes, data = draw(kind, case)
    truth = true_values(rig)
    line: dict = {"kind": kind, "case": case, "truth": truth, "scatter_true": rig.scatter}
    line["guess"] = true_values(guess)
    began = time.perf_counter()
    try:
        fit = df.fit(as_library(guess), data)
    except (df.DifffricError, ArithmeticError, ValueError) as error:
        return {**line, "error": f"{type(error).__name__}: {error}"}
    line["seconds"] = time.perf_counter() - began
    own = np.array([push.mu_s for push in pushes])
    line |= {
        "parameters": {label: found(fit, label) for label in figures.LABELS},
        "scatter": fit.scatter,
        "converged": fit.converged,
        "starts": list(fit.starts_at_optimum),
        "notes": list(fit.notes),
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "misfit": misfit(fit.work[-1]),
        "own_mu_s_z": ((fit.mu_s - own) / fit.mu_s_se).tolist(),
    }
    other = from_truth(fit, rig, own)
    line["from_truth"] = other and {"misfit": misfit(other), "apart": apart(fit, other)}
    return line


def from_truth(fit, rig: reference.Rig, own: np.ndarray):
    """The same fit of the same samples, settled from the truth, with each push's own mu_s; None
    where that leads nowhere."""
    import difffric as df
    from difffric import coordinates, settling

    model, data, _ = fit.work
    true = true_values(rig)
    theta = np.array([coordinates.to_coordinate(x, true[x]) for x in figures.LABELS])
    at = replace(
        settling.first_point(model, data, theta),
        s_eta=np.log(own / rig.mu_s),
        scatter=max(rig.scatter, LEAST_SCATTER),
    )
    try:
        return settling.settle(model, data, at, trust=1e3 if fit.kind == "recordings" else 30.0)
    except df.NumericalError:
        return None


def found(fit, label: str) -> dict:
    """Value, standard error and 95 % interval; nulls for the last two at a bound."""
    interval = fit.interval(label)
    return {
        "value": fit.value(label),
        "se": fit.standard_error(label),
        "low": None if interval is None else interval[0],
        "high": None if interval is None else interval[1],
    }


def misfit(settled) -> float:
    """-2 times the restricted log-likelihood where it stands."""
    return float(settled.components.criterion)


def apart(fit, other) -> float:
    """How far two fits are apart at most, in standard errors of the first."""
    se = np.sqrt(np.diag(fit.covariance))
    away = np.abs(fit.theta - other.theta)
    far = np.max(away / np.where(se > 0, se, 1.0))
    return float(far) if math.isfinite(far) else 1e300


def code() -> str:
    """Ten digits that stand for the source of the library and of the simulator."""
    digest = hashlib.sha256()
    for folder in (ROOT / "src" / "difffric", ROOT / "tests" / "reference"):
        for path in sorted(folder.glob("*.py")):
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:10]


def load(folder: Path, kind: str) -> list[dict]:
    """The lines of one kind, in the order of the cases; a line cut short is left out."""
    path, lines = folder / f"{kind}.jsonl", {}
    if path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            try:
                line = json.loads(text)
            except json.JSONDecodeError:
                continue
            lines[line["case"]] = line
    return [lines[case] for case in sorted(lines)]


def run(kind: str, folder: Path, cases: int, shard: tuple[int, int] = (1, 1)) -> None:
    """Do the first `cases` of a kind that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    there = {line["case"] for line in load(folder, kind)}
    todo = [i for i in range(cases) if i not in there and i % shard[1] == shard[0] - 1]
    began = time.perf_counter()
    for done, case in enumerate(todo, 1):
        text = json.dumps(run_case(kind, case), allow_nan=True)
        with (folder / f"{kind}.jsonl").open("a", encoding="utf-8") as file:
            file.write(text + "\n")
        each = (time.perf_counter() - began) / done
        left = each * (len(todo) - done) / 60
        say = f"\r{kind}: {done} of {len(todo)}, {each:.1f} s each, {left:.0f} min left "
        print(say, end="", file=sys.stderr, flush=True)
    if todo:
        print(file=sys.stderr)


def into(page: str, text: str) -> str:
    """The page with the text between its marks; they are added at its end where missing."""
    block = f"{START}\n{text}\n{END}"
    marked = re.compile(re.escape(START) + ".*?" + re.escape(END), re.DOTALL)
    if marked.search(page):
        return marked.sub(lambda _: block, page)
    return f"{page.rstrip()}\n\n{block}\n".lstrip()


def prepare() -> None:
    """Compiled programs are stored, as the tests' are, and a failed step is a NaN, which the fit
    takes as a refusal. Before JAX is imported."""
    from tests import conftest  # 64 bits, and the store of compiled programs

    assert conftest.CACHE
    os.environ.setdefault("EQX_ON_ERROR", "nan")


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--only", choices=KINDS, action="append", help="kinds (default: all)")
    parser.add_argument("--cases", type=int, help="how many of each kind (default: all)")
    parser.add_argument("--shard", default="1/1", help="i/n: the i-th of n processes")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--page", type=Path, default=PAGE)
    return parser.parse_args(words)


def main(words: Sequence[str] | None = None) -> int:
    """Run what is missing, print the figures, write the page."""
    asked = arguments(words)
    prepare()
    i, n = (int(x) for x in asked.shard.split("/"))
    folder = asked.results / code()
    for kind in asked.only or KINDS:
        cases = KINDS[kind].cases if asked.cases is None else asked.cases
        run(kind, folder, cases, (i, n))
    everything = {kind: load(folder, kind) for kind in KINDS}
    text = figures.markdown(everything, folder.name)
    print(text)
    for complaint in figures.complaints(everything):
        print(f"missed: {complaint}")
    if (i, n) == (1, 1):
        before = asked.page.read_text(encoding="utf-8") if asked.page.exists() else ""
        asked.page.write_text(into(before, text), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
