"""`difffric export`: the predictor's files, its answer and its report."""

from __future__ import annotations

import json

from difffric.commands import figures
from difffric.commands.reports.page import NO_STROKE, Picture, Report, Section, Table
from difffric.identification.controller.c_code import render_golden, render_source, state_error
from difffric.identification.controller.fitting import QUANTITIES, Exported
from difffric.identification.controller.predictor import REASONS
from difffric.number_text import format_number
from difffric.output_folder import to_json_types
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.units import to_mm, to_mm_min

_NAMES = {"force": "F_p", "distance": "d", "either": "either"}


def describe_predictor(exported: Exported, rig: Rig) -> dict:
    """Return the predictor as result.json holds it; predictor.json has the cells, too."""
    p = exported.predictor
    F_se, d_se = rig.sensor_errors
    return {
        "box": {
            "velocity_m_per_s": [p.box.slowest, p.box.fastest],
            "mu_s": [p.box.least_mu_s, p.box.most_mu_s],
        },
        "max_error": p.max_error,
        "proof": "bounded" if exported.homogeneous else "sampled",
        "bound": exported.bound,
        "worst": exported.worst,
        "random_pushes": exported.points,
        "determined": exported.determined,
        "answered": exported.answered,
        "missed": exported.missed,
        "least_elasticity": exported.least_elasticity,
        "cells": {name: int(getattr(p, name).first[-1]) for name in QUANTITIES},
        "speed_ranges": {name: len(getattr(p, name).speeds) - 1 for name in QUANTITIES},
        "dropped_cells": exported.dropped,
        "reasons": list(REASONS),
        "standard_errors": {"peak_force_N": F_se, "sliding_distance_m": d_se},
        "parameters": {
            name: float(value) for name, value in parameters.values(rig).items() if name != "mu_s"
        },
        "stroke_m": None if rig.pusher.stroke is None else float(rig.pusher.stroke),
    }


def render_files(exported: Exported, rig: Rig) -> dict[str, bytes]:
    """predictor.json, predictor.c, predictor.h and golden.csv."""
    errors = rig.sensor_errors
    stored = {**describe_predictor(exported, rig), "predictor": exported.predictor.as_dict()}
    return {
        "predictor.json": (json.dumps(to_json_types(stored), allow_nan=False) + "\n").encode(),
        **render_source(exported, rig, *errors),
        "golden.csv": render_golden(exported, rig, *errors),
    }


def report_predictor(exported: Exported, rig: Rig) -> Report:
    """Return the report of a predictor, with its figure."""
    p = exported.predictor

    def format_percent(value, digits=3):
        return "–" if value is None else format_number(100 * value, digits)

    rows = [
        [
            _NAMES[name],
            format_percent(exported.bound.get(name)),
            format_percent(exported.worst.get(name)),
            format_percent(exported.determined[name], 4),
            format_percent(exported.answered[name], 4),
            format_percent(exported.missed[name], 2),
            "" if name == "either" else str(int(getattr(p, name).first[-1])),
        ]
        for name in (*QUANTITIES, "either")
    ]
    columns = (
        "mu_s from",
        "proven bound on the error [%]",
        "largest error seen [%]",
        "determined [% of the box]",
        "answered [% of the box]",
        "missed [% of the box]",
        "cells",
    )
    table = Table("The error of mu_s, and where there is an answer", columns, rows)
    box = p.box
    summary = [
        state_error(exported),
        f"The box goes from {to_mm_min(box.slowest):g} to {to_mm_min(box.fastest):g} mm/min and "
        f"from mu_s = {box.least_mu_s:g} to {box.most_mu_s:g}. In "
        f"{format_percent(exported.answered['either'], 4)} % of it F_p or d gives mu_s.",
    ]
    if rig.pusher.stroke is None:
        summary.append(NO_STROKE)
    else:
        summary.append(
            f"With the stroke of {to_mm(float(rig.pusher.stroke)):g} mm a distance may mean "
            "several mu_s: there the predictor takes none from d."
        )
    text = [
        "mu_s is determined where the reading is monotone in it, changes by at least "
        f"{100 * exported.least_elasticity:g} % of itself for a relative change of mu_s of 1, and "
        "no other mu_s of the box gives the same reading. It is missed where it is determined and "
        "the predictor yet gives no answer.",
        "The errors are those of the polynomials against the model. What the model's own "
        "parameters are uncertain by is not in them, nor in the variances that the C function "
        "gives: those are the readings' alone.",
    ]
    picture = Picture(
        "predictor",
        "The error over the box of speeds and mu_s, and which readings are used where.",
        figures.predictor.draw_predictor(exported, rig),
    )
    use = [
        "predictor.c and predictor.h hold one function in C99, predictor.json the same "
        "polynomials. golden.csv holds readings and what the function must give for them.",
    ]
    advice = [
        "Test the function where it will run: cc -std=c99 -O2 -DDIFFFRIC_SELFTEST predictor.c "
        "-o selftest && ./selftest golden.csv"
    ]
    sections = [Section("Error", text, [table], [picture]), Section("Files", use)]
    return Report("Predictor for the controller", summary, sections, advice)
