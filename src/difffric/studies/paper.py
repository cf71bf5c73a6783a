"""The paper's measurements (Tables I-V), and everything that difffric says of them.

"Real-Time Identification of Sliding Friction Using LabVIEW FPGA". The tables lie beside this
module as printed; signs of Table V's errors are ours, the paper prints magnitudes.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.impossible_measurements import compute_lossless_bound
from difffric.identification.surrogates import PUBLISHED_DISTANCE, PUBLISHED_FORCE, weigh_by_ranges
from difffric.measurements.pushes import Pushes
from difffric.progress import Tell, silent
from difffric.rig import parameters
from difffric.rig.rig import Rig, spring_damper_rig
from difffric.simulation.families import MU_S, SPEEDS_MM_MIN, Family, family
from difffric.units import UM, from_mm, from_mm_min, to_mm, to_mm_min

if TYPE_CHECKING:
    from difffric.calibration.result import Fit
    from difffric.diagnosis.verdict import Diagnosis
    from difffric.identification.estimators import PushFriction

CONDITIONS = ("DRY", "OILY")
STROKES_MM = (1.0, 2.0, 5.0)
"""The stroke is not printed: these show how much it would change."""

PRINTED_WITHIN = 1e-3
"""A printed mu_s further than this from its own formula is a misprint (it has 3 decimals)."""


@dataclass(frozen=True)
class Printed:
    """One printed row of Tables I-V."""

    table: str
    condition: str
    velocity_mm_min: float
    mu_s_gauge: float
    quantity: str
    measured: float | None
    mu_s_printed: float | None
    error_percent_printed: float | None


def read_tables() -> list[Printed]:
    """Read Tables I-V as printed, 26 rows in their order."""
    text = (
        resources.files("difffric.studies").joinpath("paper_tables.csv").read_text(encoding="utf-8")
    )
    return [
        Printed(
            row["table"],
            row["condition"],
            float(row["velocity_mm_min"]),
            float(row["mu_s_gauge"]),
            row["quantity"],
            float(row["measured"]) if row["measured"] else None,
            float(row["mu_s_printed"]),
            float(row["error_percent_printed"]),
        )
        for row in csv.DictReader(text.splitlines())
    ]


def load_pushes() -> Pushes:
    """Return the 12 pushes behind Tables I-IV: DRY at six speeds, then OILY."""
    rows = read_tables()
    force, distance = (
        {(r.condition, r.velocity_mm_min): r for r in rows if r.quantity == quantity}
        for quantity in ("peak_force_N", "sliding_distance_um")
    )
    return Pushes(
        velocity=from_mm_min(np.array([v for _, v in force])),
        peak_force=np.array([r.measured for r in force.values()], float),
        sliding_distance=UM * np.array([distance[key].measured for key in force], float),
        mu_s_gauge=np.array([r.mu_s_gauge for r in force.values()]),
        condition=[condition for condition, _ in force],
    )


def guess_rig(stroke: float | None = None) -> Rig:
    """Return the paper's part with a first guess of what is not printed: k from equation (3)'s
    slope, C_v = sqrt(k m), and b from a damping ratio of 0.2. `stroke` is in metres."""
    mass = 18.9
    C_v = PUBLISHED_FORCE.C_v / from_mm_min(1.0)
    k = C_v**2 / mass
    return spring_damper_rig(
        mass=mass, mu_s=0.141, k=k, b=0.4 * np.sqrt(k * mass), k_v=5.0, stroke=stroke
    )


@dataclass(frozen=True)
class Paper:
    """The whole answer to the paper's measurements."""

    pushes: Pushes
    calibration: Fit
    """on the measurements that the model can reach, the pusher stopping at first release"""
    on_all: Fit
    """on all 24, the unreachable distances included"""
    strokes: dict[float, Fit]
    """calibrations with a stroke [m] instead"""
    identified: list[PushFriction]
    """each push by a calibration without its speed"""
    identified_on_all: list[PushFriction]
    """likewise, the unreachable distances included in the calibration"""
    families: Family
    diagnosis: Diagnosis
    """of all 24, all pushes of one speed held out at a time"""

    def list_rows(self) -> list[dict]:
        """List the 24 measurements of Tables I-IV, in their order."""
        return self._list_rows(self.identified)

    def _list_rows(self, identified) -> list[dict]:
        return [
            _make_row(r, _find_answer(identified, r))
            for r in read_tables()
            if r.measured is not None
        ]

    def list_weighted(self) -> list[dict]:
        """List equation (7) for every push, with surrogates and with the model, and the optimum."""
        return self._list_weighted(self.identified)

    def _list_weighted(self, identified) -> list[dict]:
        in_print = {(r.condition, r.velocity_mm_min): r for r in read_tables() if r.table == "V"}
        ratio, p, out = compute_published_ratio(), self.pushes, []
        for i, answer in enumerate(identified):
            key = (p.condition[i], _find_speed(p, i))
            blank = Printed("V", *key, float(p.mu_s_gauge[i]), "weighted", None, None, None)
            optimal = answer.mu_s_optimal
            surrogate = combine_surrogates(
                p.velocity[i], p.peak_force[i], p.sliding_distance[i], ratio
            )
            out.append(
                {
                    **_make_head(in_print.get(key, blank)),
                    "mu_s_surrogate": float(surrogate),
                    "mu_s_model": answer.mu_s_weighted.value,
                    "mu_s_model_standard_error": answer.mu_s_weighted.standard_error,
                    "weights": answer.weights,
                    "mu_s_optimal": optimal.value,
                    "mu_s_optimal_standard_error": optimal.standard_error,
                    "disagreement_in_standard_deviations": answer.disagreement,
                    "reason": answer.reason,
                }
            )
        return out

    def list_errors(self) -> list[dict]:
        """List mean absolute errors [%] over the six speeds: as printed, by the surrogates, and by
        the model calibrated without the speed judged, with and without the unreachable
        distances. Over the measurements that have an answer: how many stands beside.
        """
        rows, combined = self.list_rows(), self.list_weighted()
        rows_all, combined_all = (
            self._list_rows(self.identified_on_all),
            self._list_weighted(self.identified_on_all),
        )
        kinds = (
            ("force", rows, rows_all, "mu_s_model", "peak_force_N"),
            ("distance", rows, rows_all, "mu_s_model", "sliding_distance_um"),
            ("equation (7)", combined, combined_all, "mu_s_model", None),
            ("optimal", combined, combined_all, "mu_s_optimal", None),
        )
        return [
            _make_error_row(condition, name, some, every, model, quantity)
            for condition in CONDITIONS
            for name, some, every, model, quantity in kinds
        ]

    def misfit(self) -> list[dict]:
        """Residuals of the calibrated model at the gauge's mu_s, and what it cannot reach."""
        p, c = self.pushes, self.calibration
        d_model, bound = np.nan_to_num(c.sliding_distance), bound_distance(p)
        return [
            {
                "condition": p.condition[i],
                "velocity_mm_min": _find_speed(p, i),
                "peak_force_residual_N": float(p.peak_force[i] - c.peak_force[i]),
                "sliding_distance_residual_m": float(p.sliding_distance[i] - d_model[i]),
                "lossless_bound_m": float(bound[i]),
                "unreachable": bool(p.sliding_distance[i] > bound[i]),
            }
            for i in range(len(p))
        ]

    def stroke_study(self) -> list[dict]:
        """How the calibration would change with a stroke (missing: stops at first release)."""
        every = [(None, self.calibration), *self.strokes.items()]
        return [
            {"stroke_mm": None if stroke is None else float(to_mm(stroke)), **f.as_dict()}
            for stroke, f in every
        ]

    def as_dict(self) -> dict:
        """The answer as `result.json` holds it."""
        return {
            "rows": self.list_rows(),
            "weighted": self.list_weighted(),
            "misprints": find_misprints(),
            "calibration": self.calibration.as_dict(),
            "calibration_on_all_24": self.on_all.as_dict(),
            "strokes": self.stroke_study(),
            "misfit": self.misfit(),
            "errors": self.list_errors(),
            "stroke": "missing: the pusher stops at the first loss of contact",
            "diagnosis": self.diagnosis.as_dict(),
        }


def study(progress: Tell = silent) -> Paper:
    """Calibrate and identify the paper's pushes; `progress(what, share done)` hears how far it is.

    Distances above the lossless bound are left out of the calibration: no k, b and k_v can give
    them, so they could only bend the three. The answer has a calibration with them, too.
    """
    # They import JAX; the tables and the bound, which pictures ask for, need none.
    from difffric.calibration.calibrate import fit
    from difffric.diagnosis.procedure import diagnose
    from difffric.identification.estimators import identify

    measured, rig = load_pushes(), guess_rig()
    impossible = measured.sliding_distance > bound_distance(measured)
    nothing = np.zeros(len(measured), bool)
    speeds = sorted(set(measured.velocity.tolist()))
    work = 2 * (len(speeds) + 1) + 2 * len(STROKES_MM) + 6
    done = 0

    def step(what, by=1):
        nonlocal done
        progress(what, done / work)
        done += by

    def judge(hide_d, what):
        """A calibration on all speeds, and every push by one without its own speed."""
        step(f"calibrating {what}")
        whole = fit(rig, _hide(measured, nothing, hide_d))
        ratio, answers = family(whole.rig).range_ratio, {}
        for speed in speeds:
            step(f"judging {to_mm_min(speed):.0f} mm/min by the other speeds, {what}")
            now = measured.velocity == speed
            blind = fit(rig, _hide(measured, now, hide_d | now))
            found = identify(blind, measured, range_ratio=ratio)
            answers |= {i: found[i] for i in np.flatnonzero(now).tolist()}
        return whole, [answers[i] for i in range(len(measured))]

    calibration, identified = judge(impossible, "on what the model can reach")
    on_all, identified_on_all = judge(nothing, "on all 24 measurements")
    strokes = {}
    for stroke_mm in STROKES_MM:
        step(f"a stroke of {stroke_mm:g} mm instead", by=2)
        stroke = from_mm(stroke_mm)
        guess = parameters.with_stroke(rig, stroke)
        reachable = _hide(measured, nothing, impossible)
        strokes[stroke] = fit(guess, reachable, several_starts=False)
    step("looking for what equation (2) gets wrong", by=6)
    diagnosis = diagnose(rig, measured, held_out="speed")
    progress("done", 1.0)
    return Paper(
        pushes=measured,
        calibration=calibration,
        on_all=on_all,
        strokes=strokes,
        identified=identified,
        identified_on_all=identified_on_all,
        families=family(calibration.rig),
        diagnosis=diagnosis,
    )


def bound_distance(measured: Pushes, ratio: float = 0.75) -> NDArray:
    """Return the lossless bound on each push's d (n,) [m] at the gauge's mu_s; `ratio` is mu_k over
    mu_s."""
    return compute_lossless_bound(measured.velocity, ratio * measured.mu_s_gauge)


def _hide(measured: Pushes, hide_F, hide_d) -> Pushes:
    """Return the pushes with some forces and distances hidden, (n,) each. Their shapes stay, so
    nothing is compiled anew."""
    F = np.where(hide_F, np.nan, measured.peak_force)
    d = np.where(hide_d, np.nan, measured.sliding_distance)
    return replace(measured, peak_force=F, sliding_distance=d)


def invert_surrogate(row: Printed) -> float | None:
    """Return a measurement's mu_s by the published equation (4) or (6); None: not measured."""
    v = from_mm_min(row.velocity_mm_min)
    if row.measured is None:
        return None
    if row.quantity == "peak_force_N":
        return float(PUBLISHED_FORCE.mu_s(v, row.measured))
    return float(PUBLISHED_DISTANCE.mu_s(v, row.measured * UM))


def compute_published_ratio() -> float:
    """Return equation (7)'s ratio of ranges [N/m], of the published (3) and (5) over 500-5000
    mm/min and mu_s of 0.05-0.30."""
    v, mu = np.meshgrid(from_mm_min(SPEEDS_MM_MIN), MU_S)
    F, d = PUBLISHED_FORCE.peak_force(v, mu), PUBLISHED_DISTANCE.sliding_distance(v, mu)
    return float(np.ptp(F) / np.ptp(d))


def combine_surrogates(
    velocity: NDArray, peak_force: NDArray, sliding_distance: NDArray, ratio: float
) -> NDArray:
    """Return mu_s (n,) by equations (4), (6) and (7) as published, in SI units."""
    mu_F = PUBLISHED_FORCE.mu_s(velocity, peak_force)
    mu_d = PUBLISHED_DISTANCE.mu_s(velocity, sliding_distance)
    dF, dd = PUBLISHED_FORCE.slope(velocity, mu_F), PUBLISHED_DISTANCE.slope(velocity, mu_d)
    return weigh_by_ranges(mu_F, mu_d, dF, dd, ratio)[0]


def find_misprints() -> list[dict]:
    """List the printed mu_s that their own formula does not give."""
    return [
        {
            "table": r.table,
            "velocity_mm_min": r.velocity_mm_min,
            "printed": r.mu_s_printed,
            "recomputed": value,
        }
        for r in read_tables()
        if (value := invert_surrogate(r)) is not None
        and r.mu_s_printed is not None
        and abs(value - r.mu_s_printed) > PRINTED_WITHIN
    ]


def _make_head(r: Printed) -> dict:
    return {
        "table": r.table,
        "condition": r.condition,
        "velocity_mm_min": r.velocity_mm_min,
        "mu_s_gauge": r.mu_s_gauge,
        "mu_s_printed": r.mu_s_printed,
        "error_percent_printed": r.error_percent_printed,
    }


def _make_row(r: Printed, answer: PushFriction) -> dict:
    force = r.quantity == "peak_force_N"
    estimate = answer.mu_s_force if force else answer.mu_s_distance
    return {
        **_make_head(r),
        "quantity": r.quantity,
        "measured": r.measured,
        "mu_s_surrogate": invert_surrogate(r),
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


def _find_speed(p: Pushes, i: int) -> float:
    return round(float(to_mm_min(p.velocity[i])), 6)


def _make_error_row(condition, name, some, every, model, quantity) -> dict:
    def mean(rows, key):
        errors = [abs(r[key] / r["mu_s_gauge"] - 1) * 100 for r in rows if r[key] is not None]
        return float(np.mean(errors)) if errors else None

    def mine(rows):
        keep = (r for r in rows if r["condition"] == condition)
        return [r for r in keep if quantity is None or r["quantity"] == quantity]

    some, every = mine(some), mine(every)
    in_print = [r["error_percent_printed"] for r in some]
    return {
        "condition": condition,
        "by": name,
        "printed": None if None in in_print else float(np.mean(np.abs(in_print))),
        "surrogate": None if name == "optimal" else mean(some, "mu_s_surrogate"),
        "model": mean(some, model),
        "answered": sum(r[model] is not None for r in some),
        "model_on_all_24": mean(every, model),
        "answered_on_all_24": sum(r[model] is not None for r in every),
        "measurements": len(some),
    }
