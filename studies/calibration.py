"""A study of calibration: random rigs, simulated apart from the library, fitted from rough starts.

    python -m studies.calibration [--only tables] [--cases 100] [--shard 1/2]
                                  [--results DIR] [--page PAGE]

Every case draws a rig, its pushes, their noise and a rough guess from a seed of its own, fits
from the guess, settles once more from the truth, and appends a line of JSON to DIR/CODE/KIND.jsonl
(CODE stands for the library's source, so that no figure mixes two versions). What is there already
is not done again. The figures are printed, and set between two marks of the page.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from studies import calibration_figures as figures
from studies import runs
from tests.reference import data as reference

PAGE = runs.ROOT / "docs" / "study.md"
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
    from difffric.measurements.recordings import Channel, Recording, Recordings

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
    from difffric.rig.sensors import ForceSensor

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
        "misfit": misfit(fit.state.at),
        "own_mu_s_z": ((fit.mu_s - own) / fit.mu_s_se).tolist(),
    }
    other = from_truth(fit, rig, own)
    line["from_truth"] = other and {"misfit": misfit(other), "apart": apart(fit, other)}
    return line


def from_truth(fit, rig: reference.Rig, own: np.ndarray):
    """The same fit of the same samples, settled from the truth, with each push's own mu_s; None
    where that leads nowhere."""
    import difffric as df
    from difffric.estimation import coordinates, descent, mixed_fit

    model, data = fit.state.model, fit.state.data
    true = true_values(rig)
    theta = np.array([coordinates.to_coordinate(x, true[x]) for x in figures.LABELS])
    at = replace(
        descent.first_point(model, data, theta),
        s_eta=np.log(own / rig.mu_s),
        scatter=max(rig.scatter, LEAST_SCATTER),
    )
    try:
        return mixed_fit.settle(model, data, at, trust=1e3 if fit.kind == "recordings" else 30.0)
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


def main(words: Sequence[str] | None = None) -> int:
    """Run what is missing, print the figures, write the page."""
    asked, shard = runs.arguments("studies.calibration", __doc__ or "", tuple(KINDS), PAGE, words)
    runs.prepare(shard)
    folder = asked.results / runs.code("reference")
    sizes = {
        kind: KINDS[kind].cases if asked.cases is None else asked.cases
        for kind in asked.only or KINDS
    }
    for kind, cases in runs.take_turns(sizes, asked.rounds):
        runs.run(kind, folder, cases, partial(run_case, kind), shard)
    everything = {kind: runs.load(folder, kind) for kind in KINDS}
    text = figures.markdown(everything, folder.name)
    print(text)
    for complaint in figures.complaints(everything):
        print(f"missed: {complaint}")
    if shard == (1, 1):
        runs.write_into(asked.page, text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
