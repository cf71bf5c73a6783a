"""Rings centred with hidden friction: how many, how fast, and whether stated probabilities hold.

    .venv/bin/python -m studies.centering --rings 500

prints what docs/plan.md quotes.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_CPU_ENABLE_ASYNC_DISPATCH", "0")  # as the command line has it

import numpy as np

from difffric import spring_damper_rig
from difffric.centering.belief import Belief
from difffric.centering.planning import Known, plan
from difffric.commands.reports.centre import describe_centering
from difffric.rig import extended
from difffric.rig.rig import Rig
from difffric.studies.centering_runs import MU_S, OURS, draw_rings, run_rings
from difffric.studies.other_centering import RIVALS
from difffric.units import from_um

RIG = spring_damper_rig(mass=18.9, mu_s=0.141, mu_k_over_mu_s=0.75, k_v=5.0, k=8e5, b=1500.0)
SCATTER = 0.015
HIDDEN: dict[str, Callable[[], Rig]] = {
    "none": lambda: RIG,
    "stribeck": lambda: extended(RIG, {"stribeck": {"v_s_m_per_s": 0.02}}),
    "tilt": lambda: extended(RIG, {"tilt": {"alpha_rad": 2e-3}}),
    "pusher_ramp": lambda: extended(RIG, {"pusher_ramp": {"acceleration_m_per_s2": 5.0}}),
    "contact_hardening": lambda: extended(RIG, {"contact_hardening": {"exponent": 1.2}}),
}


def known(drift: float = 0.0) -> Known:
    """What the loop knows: the rig, and that mu_s is between 0.08 and 0.25."""
    return Known(RIG, Belief.uniform(*MU_S, SCATTER, drift))


def table(answer: dict) -> str:
    """The figures, as Markdown."""
    lines = [
        "| way | centred | median [s] | mean [s] | pushes | measurements |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for way, w in answer["ways"].items():
        name = RIVALS.get(way, "difffric")
        lines.append(
            f"| {name} | {100 * w['centred']:.1f} % | {w['time_median_s']:.2f} "
            f"| {w['time_mean_s']:.2f} | {w['pushes_mean']:.2f} | {w['measurements_mean']:.2f} |"
        )
    c = answer["calibration"]
    lines += [
        "",
        f"slope of landed over stated: {c['slope']:.3f} ± {c['slope_standard_error']:.3f} "
        f"({c['pushes']} pushes)",
        "",
        "| pushes | stated | seen |",
        "| --- | --- | --- |",
    ]
    lines += [f"| {b['pushes']} | {b['stated']:.4f} | {b['seen']:.4f} |" for b in c["bins"]]
    return "\n".join(lines)


def plan_times(n: int = 60) -> str:
    """How long one plan takes, over offsets and what is known of mu_s."""
    random = np.random.default_rng(1)
    cases = [
        (float(np.exp(random.uniform(np.log(5e-6), np.log(5e-3)))), float(random.uniform(*MU_S)))
        for _ in range(n)
    ]
    took = {"mu_s unknown": [], "after one push": []}
    for warm in (False, True):
        for e, mu_s in cases:
            for name, belief in (
                ("mu_s unknown", Belief.uniform(*MU_S, SCATTER)),
                ("after one push", Belief.normal(mu_s, 0.015, SCATTER)),
            ):
                start = time.perf_counter()
                plan(Known(RIG, belief), e, from_um(0.05))
                if warm:
                    took[name].append(1e3 * (time.perf_counter() - start))
    return "\n".join(
        f"one plan, {name}: median {np.median(t):.0f} ms, 95 % below {np.quantile(t, 0.95):.0f} ms"
        for name, t in took.items()
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rings", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hidden", choices=[*HIDDEN], default="none")
    parser.add_argument("--drift-percent", type=float, default=0.0, help="of mu_s, per push")
    parser.add_argument("--alone", action="store_true", help="not beside the other ways")
    parser.add_argument("--verify", action="store_true")
    parser.add_argument("--times", action="store_true", help="of one plan only")
    parser.add_argument("--out", type=Path)
    a = parser.parse_args()
    if a.times:
        print(plan_times())
        return
    drift = a.drift_percent / 100
    those = draw_rings(a.rings, a.seed)
    found = []
    for run in run_rings(
        known(drift), those, truth=HIDDEN[a.hidden](), drift=drift, verify=a.verify,
        ways=(OURS,) if a.alone else (OURS, *RIVALS),
        tell=lambda what, _: sys.stderr.write(f"\r{what} "),
    ):  # fmt: skip
        found.append(run)
    answer = describe_centering(found, known(drift), a.seed)
    print(table(answer))
    if a.out:
        a.out.write_text(json.dumps(answer, default=float), encoding="utf-8")


if __name__ == "__main__":
    main()
