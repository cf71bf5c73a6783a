"""The text of the fit report, as `print(fit)` shows it, in the form that lmfit made familiar."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np

_WORTH_TELLING = 0.1
"""Correlations below this size are left out, as lmfit does."""


def format_fit(answer: Mapping[str, Any]) -> str:
    """The report of a fit, from what `Fit.as_dict` gives."""
    lines = [
        *_describe_search(answer),
        *_list_parameters(answer),
        *_list_correlations(answer["correlation"], list(answer["parameters"])),
    ]
    if answer["not_identifiable"]:
        lines.append("[[Not determined by these data]]")
        lines += [
            f"    {', '.join(group['parameters'])}: {group['reason']}"
            for group in answer["not_identifiable"]
        ]
    lines += [f"    note: {note}" for note in answer["notes"]]
    return "\n".join(lines)


def _describe_search(answer: Mapping[str, Any]) -> list[str]:
    reached, starts = answer["starts_at_optimum"]
    return [
        f"[[Fit]] {len(answer['pushes'])} pushes ({answer['data']}), "
        f"{answer['samples']} measured numbers",
        f"    chi-square         = {answer['chi2']:.6g}",
        f"    reduced chi-square = {answer['reduced_chi2']:.6g}"
        f"  ({answer['degrees_of_freedom']} degrees of freedom)",
        f"    converged          = {'yes' if answer['converged'] else 'no'}"
        f"  ({reached} of {starts} starts reach this optimum)",
    ]


def _list_parameters(answer: Mapping[str, Any]) -> list[str]:
    lines = ["[[Parameters]] standard errors from the noise, not scaled by chi-square"]
    found, scatter = answer["parameters"], answer["mu_s_scatter"]
    width = max(len(label) for label in (*found, "mu_s_scatter"))
    for label, one in found.items():
        error = _format_error(one["value"], one["standard_error"])
        lines.append(f"    {label:<{width}} = {one['value']:.7g} {error}")
    error = scatter["standard_error"]
    said = f"+/- {error:.2g}" if np.isfinite(error) else "(fixed)"
    lines.append(f"    {'mu_s_scatter':<{width}} = {scatter['value']:.4g} {said}")
    return lines


def _format_error(value: float, error: float | None) -> str:
    if error is None:
        return "(at its bound)"
    if value:
        return f"+/- {error:.3g} ({100 * error / abs(value):.2f} %)"
    return f"+/- {error:.3g}"


def _list_correlations(
    correlation: Mapping[str, Mapping[str, float]], labels: list[str]
) -> list[str]:
    pairs = [(correlation[a][b], a, b) for a, b in combinations(labels, 2)]
    strong = [(abs(c), c, a, b) for c, a, b in pairs if abs(c) > _WORTH_TELLING]
    if not strong:
        return []
    lines = [f"    C({a}, {b}) = {c:+.3f}" for _, c, a, b in sorted(strong, reverse=True)]
    return [f"[[Correlations]] above {_WORTH_TELLING:g}", *lines]
