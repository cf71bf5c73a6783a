"""The report of `difffric diagnose`; the answer is the diagnosis' own `as_dict`."""

from __future__ import annotations

from difffric.commands import figures
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.diagnosis.misfit import describe_misfits
from difffric.diagnosis.next_experiment import Experiment
from difffric.diagnosis.score_test import SIGNIFICANT
from difffric.diagnosis.verdict import ADEQUATE, AMBIGUOUS, NAMED, Cause, Diagnosis
from difffric.number_text import format_number, format_pair
from difffric.units import to_mm, to_mm_min, to_um

_VERDICTS = {
    ADEQUATE: "The plain model is adequate: nothing that matters was found.",
    NAMED: "The cause is named.",
    AMBIGUOUS: "There is a cause, but these data cannot tell it from others.",
}
_TELLS = 1.0
"""Expected standard deviations between two effects below which a push tells nothing of them."""
_NOTHING = 1e-3
"""Fall of -2 log likelihood of an effect that stays at its null."""
_WANTED = "The pushes that would tell most"
_UNEXPLAINED = "The misfit is real, and no effect of the catalogue explains it."


def _format_sizes(cause: Cause) -> str:
    return "; ".join(
        f"{name} = {' ± '.join(format_pair(value, error))}"
        for name, (value, error) in cause.parameters.items()
    )


def _format_share(x: float) -> str:
    return f"{100 * x:.2g}" if x > 1e-6 else "0"


def _list_cause(cause: Cause) -> list[str]:
    return [
        cause.id,
        cause.component,
        _format_sizes(cause),
        format_number(cause.probability, 3),
        ", ".join(cause.confusable_with) or "–",
        format_number(cause.chi2_drop),
        _format_share(cause.change_peak_force),
        _format_share(cause.change_sliding_distance),
        _format_share(cause.change_as_mu_s),
    ]


_COLUMNS = (
    "effect",
    "component",
    "size",
    "probability",
    "cannot be told from",
    "fall of chi-square",
    "change of F_p [%]",
    "change of d [%]",
    "as a change of mu_s [%]",
)


_MEANING = (
    "The fall of chi-square says how much better the data are followed with the effect. The last "
    "columns say how much the effect changes F_p and d (rms over the pushes), and which change of "
    "mu_s would do as much."
)


def tabulate_considered(found: Diagnosis, gain: str = "gain on held-out pushes") -> Table:
    """Return a table of the leading effects, each alone on top of the plain model, that gain
    anything."""
    rows = [
        [
            cause.id,
            cause.component,
            _format_sizes(cause),
            format_number(cause.chi2_drop),
            format_number(cause.heldout_gain, 3),
            format_number(cause.p_value, 2),
        ]
        for cause in found.considered
        if cause.chi2_drop > _NOTHING
    ]
    columns = ("effect", "component", "size", "fall of −2 log likelihood", gain, "p-value")
    caption = "The leading effects, each alone on top of the plain model"
    if not any(cause.p_value <= SIGNIFICANT for cause in found.considered):
        caption += f"; none is significant (p-value below {SIGNIFICANT:g})"
    return Table(caption, columns, rows)


def _list_experiments(found: Diagnosis) -> list[Experiment]:
    """Return the pushes that would tell something: others are proposed where none does."""
    return [one for one in found.experiments if one.separation >= _TELLS]


def tabulate_experiments(found: Diagnosis) -> Table:
    """Return a table of the pushes that would tell more."""
    rows = [
        [
            " from ".join(x if x != "plain" else "the plain model" for x in one.separates),
            format_number(to_mm_min(one.velocity_m_per_s)),
            format_number(one.mass_kg, 3),
            "–" if one.stroke_m is None else format_number(to_mm(one.stroke_m), 3),
            format_number(one.rest_before_s, 3),
            format_number(one.separation, 2),
        ]
        for one in _list_experiments(found)
    ]
    columns = (
        "to tell apart",
        "speed [mm/min]",
        "mass [kg]",
        "stroke [mm]",
        "rest before it [s]",
        "expected difference [σ]",
    )
    return Table(_WANTED, columns, rows)


def _advise(found: Diagnosis) -> list[str]:
    """Return what to do next with a diagnosis."""
    lines = []
    if found.verdict == NAMED:
        lines.append(
            "Use the extended setup.toml, which --out writes, with all other commands: it holds "
            "the causes."
        )
    elif found.verdict == ADEQUATE:
        lines.append(
            "Go on with this model: the setup.toml that --out writes is calibrated, and difffric "
            "identify gives mu_s of each push with it, as with one that difffric fit has written."
        )
    elif found.location:
        lines.append(
            f"Look at the {found.location.component.replace('_', ' ')} of the rig: nothing in the "
            "catalogue explains the misfit there. The figure shows the form that it has."
        )
    experiments = _list_experiments(found)
    if experiments and found.verdict == AMBIGUOUS:
        lines.append(f"Make another push, which tells more: {experiments[0]}.")
    elif experiments:
        lines.append(f"For what these data cannot say, see the table “{_WANTED}”.")
    if found.remaining is not None:
        lines.append(
            "Take the standard errors as too small: what is left beside the noise is not in them."
        )
    return lines


def report_diagnosis(found: Diagnosis, go_on: str, pictures: bool) -> Report:
    """Return the report of a diagnosis; with figures where there are to be pictures. `go_on` is the
    command that goes on with a model that is adequate."""
    g, left = found.gain, found.remaining
    summary = [] if left is None else [f"{str(left).capitalize()}."]
    summary.append(_VERDICTS.get(found.verdict, _UNEXPLAINED))
    summary += [f"{cause.id}: {cause.text} ({_format_sizes(cause)})." for cause in found.causes]
    summary.append(
        f"On pushes that the fit has not seen, the model's error is {format_number(g.after, 3)} "
        f"times the noise; without the causes it is {format_number(g.before, 3)} times; "
        f"the noise floor is {format_number(g.noise_floor, 3)}."
        if found.causes
        else "On pushes that the fit has not seen, the model's error is "
        f"{format_number(g.before, 3)} times the noise; the noise floor is "
        f"{format_number(g.noise_floor, 3)}."
    )
    if found.location:
        where = found.location
        summary.append(
            f"The misfit lies in the {where.component.replace('_', ' ')}: a free curve over the "
            f"{where.quantity} explains {100 * where.explained[where.form]:.0f} % of it."
        )
    if found.causes:
        moved = format_number(100 * found.change_mu_s, 2)
        summary.append(
            f"With the causes the identified mu_s changes by {moved} % (rms of the pushes)."
        )
    sections = []
    if found.causes:
        table = Table(
            "What was added to the model",
            _COLUMNS,
            [_list_cause(c) for c in found.causes],
        )
        sections.append(Section("Causes", (_MEANING,), (table,)))
    if found.negligible:
        table = Table(
            "Detected, too small to matter", _COLUMNS, [_list_cause(c) for c in found.negligible]
        )
        text = (
            "The data show these effects, but they change F_p, d and mu_s by less than matters "
            "(--matters): they were not added to the model.",
        )
        sections.append(Section("Too small to matter", text, (table,)))
    considered = tabulate_considered(found)
    if considered.rows:
        text = (
            "Each effect was tried by itself. The gain is by how much it lowers the error on "
            "pushes that were held out of the fit.",
        )
        sections.append(Section("What was considered", text, (considered,)))
    if found.certificates:
        rows = [
            [
                str(x.push + 1),
                format_number(to_mm_min(x.velocity_m_per_s)),
                format_number(to_um(x.sliding_distance_m)),
                format_number(to_um(x.bound_m)),
            ]
            for x in found.certificates
        ]
        table = Table(
            "Distances that no k, b and k_v can give",
            ("push", "speed [mm/min]", "d [µm]", "largest possible d [µm]"),
            rows,
        )
        sections.append(Section("Beyond the plain model", tables=(table,)))
    if pictures:
        recordings = found.used_recordings
        models = "the plain model in red" + (", with its causes in blue" if found.causes else "")
        drawn = []
        if recordings:
            drawn.append(
                Picture(
                    "misfit",
                    f"How far the model misses each push: {models}.",
                    figures.diagnose.draw_misfit(found),
                )
            )
        drawn.append(
            Picture(
                "where",
                "Squared residuals over what changes during a push and between pushes, in units of "
                f"the noise: {models}.",
                figures.diagnose.draw_where(found),
            )
        )
        if recordings:
            drawn.append(
                Picture(
                    "residuals",
                    f"Residuals of the pushes that the plain model follows worst: {models}.",
                    figures.diagnose.draw_residuals(found),
                )
            )
        if found.location:
            drawn.append(
                Picture(
                    "location",
                    "Left: the share of the misfit that each component explains if it may take any "
                    "form. Right: the form of the one that explains most.",
                    figures.diagnose.draw_location(found.location),
                )
            )
        words = describe_misfits(found.misfit)
        sections.append(
            Section("Where the misfit sits", (words,) if words else (), pictures=tuple(drawn))
        )
    unseen = [x for x in found.not_visible if x not in found.impossible]
    reasons = [[name, why] for name, why in found.impossible.items()]
    reasons += [
        [name, "at its typical size it leaves too small a trace in these pushes"] for name in unseen
    ]
    if _list_experiments(found):
        sections.append(Section("What to push next", tables=(tabulate_experiments(found),)))
    if reasons:
        table = Table("Effects that these data cannot show", ("effect", "why"), reasons)
        text = ("Whether these effects are there or not, these pushes cannot say.",)
        sections.append(Section("What these data cannot say", text, (table,)))
    if found.notes:
        sections.append(Section("Notes", found.notes))
    return Report(
        "Diagnosis",
        tuple(summary),
        tuple(sections),
        _advise(found),
        go_on if found.verdict == ADEQUATE else "",
    )
