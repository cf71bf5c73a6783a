"""What a fit found in a few sentences, and what to do next with it."""

from __future__ import annotations

import math

from difffric.calibration.optimal_push import NextPush
from difffric.calibration.result import Fit
from difffric.measurements.noise import KNOWN_TO
from difffric.name_text import shorten_name
from difffric.number_text import MISSING, format_pair
from difffric.units import to_mm_min, to_um

_NAME = 40
"""Letters of a condition's name that a sentence has room for."""


def summarise_fit(fit: Fit) -> list[str]:
    """Return what a fit found, the verdict first."""
    reached, of = fit.starts_at_optimum
    kind = {"slides": "free slides"}.get(fit.kind, f"pushes ({fit.kind})")
    beside = ""
    if fit.left_out:
        beside = f"; {fit.left_out} more, beside jumps of the force or speed, were left out"
    lines = [_judge(fit)]
    for label in (x for x in fit.free if x.partition("[")[0] == "mu_s"):
        value, error = format_pair(fit.value(label), fit.standard_error(label))
        condition = shorten_name(label.partition("[")[2].removesuffix("]"), _NAME)
        said = f"{value} ± {error}"
        if label in list_open(fit):
            said = "not determined by these data"
        lines.append(f"mu_s{f' of {condition}' if condition else ''} is {said}.")
    if "mu_s" in fit.names:
        value, error = format_pair(100 * fit.scatter, 100 * fit.scatter_se)
        said = f"{value} %, as the set-up says" if error == MISSING else f"{value} ± {error} %"
        lines.append(f"From push to push mu_s scatters by {said}.")
    lines += [
        f"These data do not determine {', '.join(x['parameters'])}." for x in fit.not_identifiable
    ]
    lines.append(
        f"The fit used {len(fit.mu_s)} {kind} with {fit.samples} measured numbers{beside}; "
        f"chi-square is {fit.chi2:.6g} with {fit.degrees_of_freedom} degrees of freedom."
    )
    if of > 1:
        lines.append(f"{reached} of {of} starting points led to this result.")
    lines += [f"Note: {note}." for note in fit.notes]
    if fit.skipped:
        lines.append(f"Skipped: {len(fit.skipped)} of the data; the last table says why.")
    return lines


def list_open(fit: Fit) -> set[str]:
    """Return the labels of parameters that these data leave open, and that are at no bound."""
    every = {label for group in fit.not_identifiable for label in group["parameters"]}
    return every - set(fit.held)


def follows_data(fit: Fit, noise_error: float = KNOWN_TO) -> bool:
    """Whether the residuals are no larger than the noise and the scatter make them, where the
    standard deviation of the noise is known up to a relative error: a diagnosis allows the same."""
    by_chance = 1 + 4 * math.sqrt(2 / max(fit.degrees_of_freedom, 1))
    return not fit.reduced_chi2 > by_chance * (1 + noise_error) ** 2


def choose_command(fit: Fit) -> str:
    """Return the command that the verdict leads to: `identify`, `diagnose`, or none."""
    if not fit.converged:
        return ""
    return "identify" if follows_data(fit) else "diagnose"


def _judge(fit: Fit) -> str:
    """Return what is to be thought of a fit, in a sentence."""
    chi2 = f"reduced chi-square {fit.reduced_chi2:.3g}, where 1 is expected"
    if not fit.converged:
        return f"The fit did NOT converge: its numbers are not to be used ({chi2})."
    if not follows_data(fit):
        return f"The fit converged, but the model does not follow the data to their noise ({chi2})."
    if math.isfinite(fit.spread_force) or math.isfinite(fit.spread_distance):
        return (
            "The fit converged. How far the data spread was estimated with it, so that they cannot "
            "show whether the model follows them."
        )
    if not follows_data(fit, noise_error=0.0):
        return (
            f"The fit converged, and the model follows the data to within {100 * KNOWN_TO:g} % of "
            f"their noise (reduced chi-square {fit.reduced_chi2:.3g}: more than chance, too little "
            "to matter)."
        )
    return f"The fit converged, and the model follows the data to their noise ({chi2})."


def advise(fit: Fit, push: NextPush | None, no_push: str | None) -> list[str]:
    """Return what to do next with a fit."""
    lines = []
    if not fit.converged:
        lines.append(
            "Begin with a set-up that is nearer to the rig, or with fewer free parameters (--free)."
        )
    if fit.not_identifiable and push is None:
        lines.append(
            "What these data do not determine needs other pushes, or --free without it: "
            "difffric fit --next-push names the push that tells most."
        )
    lines += describe_next(push, no_push)
    then = choose_command(fit)
    if then == "diagnose":
        lines.append("Run difffric diagnose on the same data: it looks for what the model lacks.")
    elif then:
        lines.append(
            "Use the fitted setup.toml, which --out writes: difffric identify gives mu_s of each "
            "push with it."
        )
    return lines


def describe_next(best: NextPush | None, why_not: str | None) -> list[str]:
    """Return which push would tell most, or why there is none; nothing where none was asked for."""
    if best is None:
        return [f"No next push is proposed: {why_not}."] if why_not else []
    which = f" of {shorten_name(best.condition, _NAME)}" if best.condition else ""
    return [
        f"Make a push{which} at {to_mm_min(best.velocity):.0f} mm/min with {best.mass:.4g} kg: it "
        "tells most about all parameters together. The model expects F_p = "
        f"{best.peak_force:.4g} N and d = {to_um(best.sliding_distance):.4g} µm."
    ]
