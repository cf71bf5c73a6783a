"""Worst errors against the reference pushes: `python -m studies.accuracy` prints the table that
docs/performance.md holds."""

from __future__ import annotations

import equinox as eqx
import jax
import numpy as np

from difffric.simulation.events import Regime
from difffric.simulation.sensitivities import sensitivity
from tests.against.test_reference import CASES, QUANTITIES, natural_scale, rigs


def relative_errors():
    """(case, |F_p|, |d|, worst derivative of each) relative errors, NaN where there is none."""
    solve = eqx.filter_jit(eqx.filter_vmap(lambda rig, v: sensitivity(rig, v)))
    rows = []
    for stroked in (False, True):
        some = [c for c in CASES if (c["stroke_m"] is not None) == stroked]
        found = jax.tree.map(np.asarray, solve(*rigs(some)))
        for i, case in enumerate(some):
            errors = []
            for quantity, (value, key) in QUANTITIES.items():
                exact = case[value]
                got = getattr(found.observables, quantity)[i]
                errors.append(np.nan if exact is None else abs(got / exact - 1))
                slopes = case["derivatives"][key] or {}
                worst = [
                    abs(getattr(found, quantity)[name][i] / slope - 1)
                    for name, slope in slopes.items()
                    if slope and abs(slope) * natural_scale(case, name) > 1e-6 * exact
                    and not (name == "b_N_s_per_m" and case[name] == 0)
                ]  # fmt: skip
                errors.append(max(worst, default=np.nan))
            rows.append((case, errors))
    return rows


def main():
    """Print one row a class of pushes."""
    jax.config.update("jax_enable_x64", True)
    rows = relative_errors()
    groups = [
        (r.word, lambda c, r=r: c["regime"] == r.word and not c.get("near_edge")) for r in Regime
    ]
    groups += [
        ("2 to 8 contacts", lambda c: 2 <= c["contacts"] <= 8 and not c.get("near_edge")),
        ("9 to 16 contacts", lambda c: c["contacts"] > 8 and not c.get("near_edge")),
        ("margin below 1e-3", lambda c: bool(c.get("near_edge"))),
        ("all with a margin above 1e-3", lambda c: not c.get("near_edge")),
    ]
    print("| pushes | number | F_p | dF_p | d | dd |\n|---|---|---|---|---|---|")
    for name, belongs in groups:
        errors = np.array([e for case, e in rows if belongs(case)])
        shown = []
        for column in errors.T:
            known = column[np.isfinite(column)]
            shown.append(f"{known.max():.0e}" if len(known) else "–")
        print(f"| {name} | {len(errors)} | {' | '.join(shown)} |")


if __name__ == "__main__":
    main()
