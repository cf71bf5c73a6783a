"""A predictor as C99, and the golden vectors that a compiled one must give."""

from __future__ import annotations

from importlib import resources
from string import Template

import numpy as np

from difffric.identification.controller.fitting import Exported, compute_readings, draw_points
from difffric.identification.controller.predictor import Cells
from difffric.rig import parameters
from difffric.rig.rig import Rig

GOLDEN = (
    "v_m_per_s", "F_p_N", "d_m", "F_p_se_N", "d_se_m", "true_mu_s", "mu_s", "variance",
    "mu_s_force", "variance_force", "mu_s_distance", "variance_distance", "status", "force",
    "distance",
)  # fmt: skip
"""Columns of golden.csv. `true_mu_s` is the model's; nan where the readings are made up."""


def state_error(exported: Exported) -> str:
    """One sentence on the error."""
    worst = 100 * max(exported.worst.values())
    tried = f"the largest error of {exported.points} random pushes is {worst:.2g} %"
    if not exported.homogeneous:
        return f"Where the model determines mu_s, {tried}; a bound is not proven."
    bound = 100 * max(x or 0.0 for x in exported.bound.values())
    return (
        f"Where the model determines mu_s, the predictor errs by {bound:.2g} % at most, which is "
        f"proven; {tried}."
    )


def render_source(
    exported: Exported, rig: Rig, peak_force_se: float | None, sliding_distance_se: float | None
) -> dict[str, bytes]:
    """predictor.c and predictor.h. The standard errors [N, m] are the set-up's, None: not said."""
    p = exported.predictor
    box = p.box
    names = {
        "statement": state_error(exported),
        "slowest": _c(p.slowest),
        "fastest": _c(p.fastest),
        "box_speeds": f"{box.slowest:.6g} to {box.fastest:.6g}",
        "least_mu_s": f"{box.least_mu_s:g}",
        "most_mu_s": f"{box.most_mu_s:g}",
        "lowest_answer": _c(box.least_mu_s * (1 - p.max_error)),
        "highest_answer": _c(box.most_mu_s * (1 + p.max_error)),
        "max_error": _c(p.max_error),
        "peak_force_se": _c(peak_force_se or 0.0),
        "sliding_distance_se": _c(sliding_distance_se or 0.0),
        "rig": _rig(rig),
        "tables": "\n\n".join(_table(name, getattr(p, name)) for name in ("force", "distance")),
    }
    for name in ("force", "distance"):
        cells: Cells = getattr(p, name)
        names[f"{name}_ranges"] = str(len(cells.speeds) - 1)
        names[f"{name}_tau"], names[f"{name}_xi"] = map(str, cells.coefficients.shape[1:])
    folder = resources.files("difffric.identification.controller")
    return {
        f"predictor.{ending}": Template(
            folder.joinpath(f"predictor_template.{ending}").read_text(encoding="utf-8")
        )
        .substitute(names)
        .encode()
        for ending in ("c", "h")
    }


def render_golden(
    exported: Exported, rig: Rig, F_se: float | None, d_se: float | None, n: int = 400
) -> bytes:
    """golden.csv: exact readings all over the box with and without standard errors, then readings
    that are missing, outside and impossible."""
    p, random = exported.predictor, np.random.default_rng(1)
    v, mu_s = draw_points(random, p.box, n)
    seen = compute_readings(rig, v, mu_s)
    F, d = seen["force"][0], seen["distance"][0]
    errors = [np.full(n, F_se or 0.5), np.full(n, d_se or 0.3e-6)]
    for i, error in enumerate(errors):
        error[5 + i :: 10] = np.nan
    errors[1][np.arange(5, n, 20)] = np.nan
    v[7::40] = p.box.fastest * 1.01
    F[8::40] *= 3
    d[9::40] *= 20
    F[10::20], d[11::20], d[12::40], F[12::40] = np.nan, np.nan, np.nan, np.nan
    F[13::40], d[14::40] = -1.0, 0.0
    made_up = np.zeros(n, bool)
    for first in (7, 8, 9, 13, 14):
        made_up[first::40] = True
    found = p.predict(v, F, d, *errors)
    columns = [v, F, d, *errors, np.where(made_up, np.nan, mu_s), *found]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    lines = [",".join(map(repr, row)) for row in rows]
    return "\n".join([",".join(GOLDEN), *lines, ""]).encode()


def _rig(rig: Rig) -> str:
    values = parameters.values(rig)
    said = ", ".join(f"{name} {float(x):g}" for name, x in values.items() if name != "mu_s")
    stroke = rig.pusher.stroke
    return said + ("" if stroke is None else f", stroke {float(stroke):g} m")


def _table(name: str, cells: Cells) -> str:
    m = max(int(cells.first[-1]), 1)
    return "\n".join(
        [
            _array(f"double {name}_speeds", cells.speeds),
            _array(f"int {name}_first", cells.first),
            _array(f"double {name}_lower", cells.lower[:m]),
            _array(f"double {name}_upper", cells.upper[:m]),
            _array(f"double {name}_c", cells.coefficients[:m].ravel()),
        ]
    )


def _array(declared: str, values) -> str:
    shown = [str(int(x)) if declared.startswith("int") else _c(x) for x in values]
    width = 12 if declared.startswith("int") else 4
    lines = [", ".join(shown[i : i + width]) for i in range(0, len(shown), width)]
    body = ",\n    ".join(lines)
    return f"static const {declared}[{len(shown)}] = {{\n    {body}\n}};"


def _c(value) -> str:
    """A number to its last digit."""
    text = repr(float(value))
    return text if any(c in text for c in ".en") else text + ".0"
