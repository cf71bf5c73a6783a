"""The paper's measurements, explained: what equation (2) cannot do, and what mends it.

The tables are those of `published_tables`. The plain model is fitted to what it can reach; the
search of `diagnosis.combinations` says what it lacks; every measurement is then judged by both,
each calibrated without its speed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.impossible_measurements import compute_lossless_bound, find_unreachable
from difffric.identification.surrogates import fit_force
from difffric.known_so_far import tell_known
from difffric.measurements.pushes import Pushes
from difffric.number_text import format_values
from difffric.progress import Steps, Tell, silent
from difffric.rig import parameters
from difffric.rig.setup import Setup
from difffric.simulation.families import Family, family
from difffric.studies.published_tables import (
    CONDITIONS,
    Printed,
    assume_errors,
    combine_surrogates,
    compute_published_ratio,
    find_misprints,
    guess_rig,
    invert_surrogate,
    load_pushes,
    read_tables,
)
from difffric.units import to_mm_min

if TYPE_CHECKING:
    from difffric.calibration.result import Fit
    from difffric.diagnosis.combinations.explanation import Explanation
    from difffric.identification.estimators import PushFriction
    from difffric.studies.next_push import Proposal

_ENDS = (0.06, 0.15, 0.65, 0.7, 0.95, 0.97, 1.0)
"""The share of the whole that is done at the end of each step."""


@dataclass(frozen=True)
class Judged:
    """A model fitted to the measurements, and each push's mu_s by it."""

    fit: Fit
    """to all of them, or to those that it can reach"""
    identified: list[PushFriction]
    """each push by a calibration that has not seen its speed"""


@dataclass(frozen=True)
class Paper:
    """The whole answer to the paper's measurements."""

    pushes: Pushes
    by_force: Fit
    """k and b on the twelve forces alone, all with the same error"""
    plain: Judged
    """equation (2) as printed, on the measurements that it can reach"""
    extended: Judged
    """with what the search found, on all 24"""
    explanation: Explanation
    families: Family
    """of the extended model"""
    proposals: list[Proposal]
    """pushes that would settle what these numbers leave open, the best first"""

    def list_rows(self) -> list[dict]:
        """List the 24 measurements of Tables I-IV, in their order."""
        return [
            _make_row(r, *(_find_answer(x.identified, r) for x in (self.plain, self.extended)))
            for r in read_tables()
            if r.measured is not None
        ]

    def list_weighted(self) -> list[dict]:
        """List equation (7) for every push, with surrogates and with both models."""
        in_print = {(r.condition, r.velocity_mm_min): r for r in read_tables() if r.table == "V"}
        ratio, p, out = compute_published_ratio(), self.pushes, []
        for i, answer in enumerate(self.extended.identified):
            key = (p.condition[i], find_speed(p, i))
            blank = Printed("V", *key, float(p.mu_s_gauge[i]), "weighted", None, None, None)
            surrogate = combine_surrogates(
                p.velocity[i], p.peak_force[i], p.sliding_distance[i], ratio
            )
            plain = self.plain.identified[i]
            out.append(
                {
                    **_make_head(in_print.get(key, blank)),
                    "mu_s_surrogate": float(surrogate),
                    "mu_s_plain": plain.mu_s_weighted.value,
                    "mu_s_model": answer.mu_s_weighted.value,
                    "mu_s_model_standard_error": answer.mu_s_weighted.standard_error,
                    "weights": answer.weights,
                    "mu_s_optimal_plain": plain.mu_s_optimal.value,
                    "mu_s_optimal": answer.mu_s_optimal.value,
                    "mu_s_optimal_standard_error": answer.mu_s_optimal.standard_error,
                    "disagreement_in_standard_deviations": answer.disagreement,
                    "reason": answer.reason,
                }
            )
        return out

    def list_errors(self) -> list[dict]:
        """List mean absolute errors [%] over the six speeds: as printed, by the surrogates, and by
        both models calibrated without the speed judged. Over the measurements that have an answer:
        how many stands beside.
        """
        rows, combined = self.list_rows(), self.list_weighted()
        kinds = (
            ("force", rows, "mu_s_plain", "mu_s_model", "peak_force_N"),
            ("distance", rows, "mu_s_plain", "mu_s_model", "sliding_distance_um"),
            ("equation (7)", combined, "mu_s_plain", "mu_s_model", None),
            ("optimal", combined, "mu_s_optimal_plain", "mu_s_optimal", None),
        )
        return [
            _make_error_row(condition, name, every, plain, model, quantity)
            for condition in CONDITIONS
            for name, every, plain, model, quantity in kinds
        ]

    def misfit(self) -> list[dict]:
        """Residuals of both models at the gauge's mu_s, and what the plain one cannot reach."""
        p, bound = self.pushes, bound_distance(self.pushes)
        out = []
        for i in range(len(p)):
            row = {"condition": p.condition[i], "velocity_mm_min": find_speed(p, i)}
            for name, fit in (("plain", self.plain.fit), ("extended", self.extended.fit)):
                d = float(np.nan_to_num(fit.sliding_distance[i]))
                row[f"peak_force_residual_N_{name}"] = float(p.peak_force[i] - fit.peak_force[i])
                row[f"sliding_distance_residual_m_{name}"] = float(p.sliding_distance[i] - d)
            out.append(
                {
                    **row,
                    "lossless_bound_m": float(bound[i]),
                    "unreachable": bool(p.sliding_distance[i] > bound[i]),
                }
            )
        return out

    def list_stages(self) -> list[dict]:
        """List what each part buys: the best model of each number of parts."""
        e, known = self.explanation, frozenset[str]()
        out = []
        for one, error in zip(e.stages, e.held_out, strict=True):
            out.append(
                {
                    "added": sorted(one.parts - known),
                    "dropped": sorted(known - one.parts),
                    "heldout_nrmse": error,
                    "parameters": e.list_values(one),
                }
            )
            known = one.parts
        return out

    def compare_slopes(self) -> list[dict]:
        """List C_v and C_mu of equation (3) and dF_p/dmu_s [N] over speed, of k and b as the forces
        want them, as the plain model has them and of the extended model."""
        by = [(name, family(rig)) for name, rig in self._list_contacts()]
        out = []
        for name, grid in by:
            found = fit_force(grid)
            slope = np.polynomial.polynomial.polyfit(grid.mu_s, grid.peak_force.T, 1)[1]
            out.append(
                {
                    "model": name,
                    "C_v_N_min_per_mm": found.C_v,
                    "C_mu_N": found.C_mu,
                    "velocity_mm_min": to_mm_min(grid.velocity).tolist(),
                    "slope_N": slope.tolist(),
                }
            )
        return out

    def _list_contacts(self) -> list[tuple[str, Any]]:
        models = {"forces": self.by_force, "plain": self.plain.fit, "extended": self.extended.fit}
        return [(name, fit.rig) for name, fit in models.items()]

    def as_dict(self) -> dict:
        """The answer as `result.json` holds it."""
        return {
            "rows": self.list_rows(),
            "weighted": self.list_weighted(),
            "misprints": find_misprints(),
            "calibration": self.plain.fit.as_dict(),
            "calibration_by_force": self.by_force.as_dict(),
            "calibration_extended": self.extended.fit.as_dict(),
            "slopes": self.compare_slopes(),
            "stages": self.list_stages(),
            "misfit": self.misfit(),
            "errors": self.list_errors(),
            "proposals": [one.as_dict() for one in self.proposals],
            "stroke": "missing: the plain model's pusher stops at the first loss of contact",
            "diagnosis": self.explanation.as_diagnosis(self.extended.fit, self.certificates),
        }

    @property
    def certificates(self) -> tuple:
        """The measured distances that no k, b and k_v can give."""
        exact = replace(self.pushes, sliding_distance_se=np.full(len(self.pushes), np.nan))
        return find_unreachable(exact, guess_rig())


def study(progress: Tell = silent) -> Paper:
    """Explain the paper's pushes, step by step; `progress(what, share done)` hears how far it is.

    The plain model is calibrated on what it can reach: distances above the lossless bound could
    only bend its k, b and k_v. The extended model is calibrated on everything.
    """
    # They import JAX; the tables and the bound, which pictures ask for, need none.
    from difffric.calibration.calibrate import fit
    from difffric.diagnosis.combinations.explanation import explain_table

    measured, rig = load_pushes(), guess_rig()
    F_se, d_se = assume_errors(measured.peak_force, measured.sliding_distance)
    measured = replace(measured, peak_force_se=F_se, sliding_distance_se=d_se)
    nothing = np.zeros(len(measured), bool)
    impossible = measured.sliding_distance > bound_distance(measured)
    folds = np.unique(measured.velocity, return_inverse=True)[1]
    reachable = hide(measured, nothing, impossible)

    steps = Steps(progress, _ENDS)
    steps.begin("calibrating equation (2)")
    # Each force is as good as another here: a plain least-squares line is what (3) is, too.
    forces = replace(
        hide(measured, nothing, ~nothing), peak_force_se=np.full(len(measured), np.nan)
    )
    no_drag = parameters.with_values(rig, {"k_v_N_s_per_m": 0.0})
    by_force = fit(no_drag, forces, free=("k_N_per_m", "b_N_s_per_m"), several_starts=False)
    plain = fit(rig, reachable)
    values = {label: plain.value(label) for label in plain.free}
    tell_known("equation (2), fitted to what it can reach", format_values(values))
    tell = steps.begin("judging by equation (2)")
    starts = [Setup(plain.rig)] * (int(folds.max()) + 1)
    plain_by = judge(measured, folds, starts, plain, hide_d=impossible, tell=tell)
    found = explain_table(rig, measured, folds, steps.begin("looking for what it lacks"))
    parts = ", ".join(sorted(found.best.parts))
    tell_known("what equation (2) lacks, before it is judged", parts)
    steps.begin("calibrating the extended model")
    extended = fit(found.extend_setup(found.best), measured, several_starts=False)
    extended_by = judge(
        measured,
        folds,
        [found.extend_setup(one) for one in found.list_blind(found.best)],
        extended,
        tell=steps.begin("judging by the extended model"),
    )
    steps.begin("looking for the next experiment")
    proposals = _propose(found, extended)
    steps.begin("drawing")
    return Paper(
        pushes=measured,
        by_force=by_force,
        plain=Judged(plain, plain_by),
        extended=Judged(extended, extended_by),
        explanation=found,
        families=family(extended.rig),
        proposals=proposals,
    )


def _propose(found: Explanation, extended: Fit) -> list[Proposal]:
    """Propose the push that tells the best model from its first rival, then those that determine
    the numbers whose errors are the largest."""
    from difffric.studies.next_push import determine, tell_apart

    out = []
    for rival in found.rivals[:1]:
        other = found.extend_setup(rival).rig
        gone, instead = (
            ", ".join(sorted(x))
            for x in (found.best.parts - rival.parts, rival.parts - found.best.parts)
        )
        out.append(tell_apart(extended.rig, other, f"{gone} or {instead}"))
    share = {x: (extended.standard_error(x) or 0.0) / extended.value(x) for x in extended.free}
    loose = sorted(share, key=lambda x: -share[x])
    return out + determine(extended, loose[:3])


def judge(
    measured: Pushes,
    folds: NDArray,
    starts: list,
    whole: Fit,
    hide_d: NDArray | None = None,
    tell: Tell = silent,
) -> list[PushFriction]:
    """Every push's mu_s by a calibration without its speed: fold j starts from the set-up
    `starts[j]`. Distances of `hide_d` (n,) are in no calibration."""
    from difffric.calibration.calibrate import fit
    from difffric.identification.estimators import identify

    hidden = np.zeros(len(measured), bool) if hide_d is None else hide_d
    ratio, answers = family(whole.rig).range_ratio, {}
    for j, start in enumerate(starts):
        now = folds == j
        v = find_speed(measured, int(np.argmax(now)))
        tell(f"{v:.0f} mm/min by the other speeds", j / len(starts))
        blind = fit(start, hide(measured, now, hidden | now), several_starts=False)
        own = identify(blind, measured.select(now), range_ratio=ratio)
        answers |= dict(zip(np.flatnonzero(now).tolist(), own, strict=True))
    return [answers[i] for i in range(len(measured))]


def bound_distance(measured: Pushes, ratio: float = 0.75) -> NDArray:
    """Return the lossless bound on each push's d (n,) [m] at the gauge's mu_s; `ratio` is mu_k over
    mu_s."""
    return compute_lossless_bound(measured.velocity, ratio * measured.mu_s_gauge)


def hide(measured: Pushes, hide_F: NDArray, hide_d: NDArray) -> Pushes:
    """Return the pushes with some forces and distances hidden, (n,) each."""
    F = np.where(hide_F, np.nan, measured.peak_force)
    d = np.where(hide_d, np.nan, measured.sliding_distance)
    return replace(measured, peak_force=F, sliding_distance=d)


def find_speed(p: Pushes, i: int) -> float:
    """The speed of push i [mm/min], as the tables print it."""
    return round(float(to_mm_min(p.velocity[i])), 6)


def _make_head(r: Printed) -> dict:
    return {
        "table": r.table,
        "condition": r.condition,
        "velocity_mm_min": r.velocity_mm_min,
        "mu_s_gauge": r.mu_s_gauge,
        "mu_s_printed": r.mu_s_printed,
        "error_percent_printed": r.error_percent_printed,
    }


def _make_row(r: Printed, plain: PushFriction, answer: PushFriction) -> dict:
    force = r.quantity == "peak_force_N"
    before, estimate = (x.mu_s_force if force else x.mu_s_distance for x in (plain, answer))
    return {
        **_make_head(r),
        "quantity": r.quantity,
        "measured": r.measured,
        "mu_s_surrogate": invert_surrogate(r),
        "mu_s_plain": before.value,
        "mu_s_model": estimate.value,
        "mu_s_model_standard_error": estimate.standard_error,
        "reason": answer.reason if estimate.value is None else None,
    }


def _find_answer(identified: list[PushFriction], r: Printed) -> PushFriction:
    return next(
        a
        for a in identified
        if a.condition == r.condition and np.isclose(to_mm_min(a.velocity), r.velocity_mm_min)
    )


def _make_error_row(
    condition: str, name: str, rows: list[dict], plain: str, model: str, quantity: str | None
) -> dict:
    mine = [r for r in rows if r["condition"] == condition]
    mine = [r for r in mine if quantity is None or r["quantity"] == quantity]

    def mean(key: str) -> float | None:
        errors = [abs(r[key] / r["mu_s_gauge"] - 1) * 100 for r in mine if r[key] is not None]
        return float(np.mean(errors)) if errors else None

    in_print = [r["error_percent_printed"] for r in mine]
    return {
        "condition": condition,
        "by": name,
        "printed": None if None in in_print else float(np.mean(np.abs(in_print))),
        "surrogate": None if name == "optimal" else mean("mu_s_surrogate"),
        "plain": mean(plain),
        "answered_plain": sum(r[plain] is not None for r in mine),
        "model": mean(model),
        "answered": sum(r[model] is not None for r in mine),
        "measurements": len(mine),
    }
