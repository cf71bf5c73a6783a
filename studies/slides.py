"""Is a fit biased where friction scatters from push to push, and do its intervals hold?

    python -m studies.slides [--only slides] [--cases 200] [--shard 1/2] [--page PAGE]

Free slides, whose distance alone is measured, and pushes of which F_p, d or both are, with a
scatter of mu_s of 1.5, 3 and 5.7 %. Every case draws its data from a seed of its own. What is there
already is not done again; the figures are printed, and set between two marks of the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

import difffric as df
from studies import runs
from tests.reference import data as reference

PAGE = runs.ROOT / "docs" / "study.md"
TRUTH = reference.Rig(m=0.37, mu_s=0.27, ratio=0.75, k_v=0.1, k=8e5, b=1500.0)
"""The slides': a block of acrylic of 0.37 kg."""
GUESS = df.spring_damper_rig(mass=0.37, mu_s=0.2, k=8e5, b=1500.0, k_v=0.02)
PUSHED = reference.Rig(m=18.9, mu_s=0.141, ratio=0.75, k_v=8.0, k=8e5, b=1500.0)
"""The pushes'; the tip stops where contact is first lost."""
STROKE = 2e-3
"""A tip that goes on to this stroke meets the part again, and d jumps and bends with mu_s."""
SCATTERS = (0.015, 0.03, 0.057)
PARTS = {
    "slides": (402, ("k_v_N_s_per_m", "mu_s")),
    "few slides": (50, ("k_v_N_s_per_m", "mu_s")),
    "forces": (50, ("k_N_per_m", "mu_s")),
    "distances": (50, ("k_v_N_s_per_m", "mu_s")),
    "both": (50, ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m", "mu_s")),
    "both with a stroke": (50, ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m", "mu_s")),
}
"""How many pushes each has, and what is free."""
CASES, CASES_WITH_STROKE = 200, 30
FIELDS = {"k_N_per_m": "k", "b_N_s_per_m": "b", "k_v_N_s_per_m": "k_v", "mu_s": "mu_s"}


def make_slides(seed: int, n: int, scatter: float) -> df.Pushes:
    """Free slides at 0.14 to 0.8 m/s, whose distances are read to 0.3 mm."""
    rig = replace(TRUTH, scatter=scatter)
    rng = np.random.default_rng([seed, round(1e4 * scatter), n])
    made = reference.measure_slides(
        rig, rng, n=n, slowest=0.14, fastest=0.8, velocity_se=1e-6, distance_se=3e-4
    )
    return df.Pushes(**made.columns)


def make_pushes(part: str, truth: reference.Rig, seed: int, n: int, scatter: float) -> df.Pushes:
    """Pushes with errors of 0.5 N and 0.3 µm, of which F_p, d or both were measured."""
    rig = replace(truth, scatter=scatter)
    rng = np.random.default_rng([seed, round(1e4 * scatter), n, 1])
    columns = reference.measure(reference.make_pushes(rig, rng, n), rng)
    for name, only in (("sliding_distance", "forces"), ("peak_force", "distances")):
        if part == only:
            del columns[name], columns[f"{name}_se"]
    return df.Pushes(**columns)


def run_case(part: str, scatter: float, case: int) -> dict:
    """The fit of one set: each free parameter's value, error and whether its interval holds."""
    n, free = PARTS[part]
    if part.endswith("slides"):
        truth, rig, data = TRUTH, GUESS, make_slides(case, n, scatter)
    else:
        truth = replace(PUSHED, stroke=STROKE if part.endswith("stroke") else None)
        data = make_pushes(part, truth, case, n, scatter)
        rig = df.spring_damper_rig(
            mass=truth.m, mu_s=truth.mu_s, k=truth.k, b=truth.b, k_v=truth.k_v, stroke=truth.stroke
        )
    fit = df.fit(rig, data, free=free)
    line: dict = {"case": case, "converged": fit.converged}
    for label in free:
        true, ends = getattr(truth, FIELDS[label]), fit.interval(label)
        line[label] = {
            "off": fit.value(label) - true,
            "se": fit.standard_error(label),
            "holds": ends is not None and bool(ends[0] <= true <= ends[1]),
        }
    return line


def tabulate(found: dict[tuple[str, float], list[dict]]) -> str:
    """The figures as a page has them."""
    out = [
        "| data | scatter | parameter | sets | bias, in standard errors of one fit "
        "| 95 % intervals hold | not converged |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (part, scatter), lines in found.items():
        for label in PARTS[part][1] if lines else ():
            every = [line[label] for line in lines]
            errors = [x["se"] for x in every if x["se"] is not None]
            bias = np.mean([x["off"] for x in every]) / np.mean(errors)
            sure = 1 / np.sqrt(len(every))
            out.append(
                f"| {PARTS[part][0]} {part.removeprefix('few ')} | {100 * scatter:g} % | {label} | "
                f"{len(every)} | {bias:+.2f} ± {sure:.2f} | "
                f"{100 * np.mean([x['holds'] for x in every]):.1f} % | "
                f"{sum(not line['converged'] for line in lines)} |"
            )
    return "\n".join(out)


def main(words: Sequence[str] | None = None) -> int:
    """Run what is missing, print the figures, write the page."""
    asked, shard = runs.arguments("studies.slides", __doc__ or "", tuple(PARTS), PAGE, words)
    runs.prepare(shard)
    folder = asked.results / "slides" / runs.code("reference")
    found, sizes, one = {}, {}, {}
    for part in asked.only or PARTS:
        for scatter in SCATTERS:
            name = f"{part} {scatter:g}".replace(" ", "_")
            one[name] = partial(run_case, part, scatter)
            most = CASES_WITH_STROKE if part.endswith("stroke") else CASES
            sizes[name] = most if asked.cases is None else asked.cases
    for name, number in runs.take_turns(sizes, asked.rounds):
        runs.run(name, folder, number, one[name], shard)
    for part in PARTS:
        for scatter in SCATTERS:
            found[part, scatter] = runs.load(folder, f"{part} {scatter:g}".replace(" ", "_"))
    text = tabulate(found)
    print(text)
    if shard == (1, 1):
        runs.write_into(asked.page, text, "scatter")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
