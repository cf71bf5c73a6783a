"""What the commands say of an axis: answers for result.json, and reports for a person."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from difffric.axis.diagnosis.verdict import AxisDiagnosis
from difffric.axis.motion.trajectory import AxisTrajectory
from difffric.axis.result import AxisFit, FrictionLevel
from difffric.axis.setup import AxisSetup
from difffric.commands.axis import figures
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.number_text import format_number, format_pair
from difffric.units import to_um


def report_fit(fit: AxisFit, pictures: bool) -> Report:
    """Return the report of a fitted axis; with figures where there are to be pictures."""
    imposed = (
        ["The motion is imposed: the force is what answers, and is fitted as it is."]
        if fit.imposed
        else []
    )
    summary = [
        f"{len(fit.data)} stretches, {fit.data.samples} samples.",
        "Converged." if fit.converged else "Did NOT converge.",
        *imposed,
        *(f"Open: {', '.join(x['parameters'])}: {x['reason']}." for x in fit.not_identifiable),
        *(f"Note: {note}." for note in fit.notes),
    ]
    sections = [
        Section(
            "Parameters",
            (
                "Standard errors come from the noise as it was found in the data: the encoder's, "
                "forces that nothing explains, and the friction level that each stretch has.",
            ),
            [_tabulate_parameters(fit), *_tabulate_open(fit), *_tabulate_correlations(fit)],
        ),
        Section("Stretches", (), [_tabulate_levels(fit.levels)]),
        Section("Noise", (), [_tabulate_noise(fit)]),
    ]
    if pictures:
        sections.append(Section("Pictures", (), (), _draw_fit(fit)))
    return Report("An axis fitted", summary, sections)


def report_levels(setup: AxisSetup, levels: Sequence[FrictionLevel], pictures: bool) -> Report:
    """Return the report of the friction levels."""
    said = [x for x in levels if x.coulomb is not None]
    summary = [f"{len(said)} of {len(levels)} stretches say their Coulomb friction."]
    drawn = []
    if pictures and said:
        caption = "Coulomb friction of each stretch; line: the set-up's."
        drawn.append(Picture("levels", caption, figures.draw_levels(setup, levels)))
    return Report(
        "Friction of each stretch",
        summary,
        [Section("Stretches", (), [_tabulate_levels(levels)], drawn)],
    )


def report_diagnosis(found: AxisDiagnosis, pictures: bool) -> Report:
    """Return the report of a diagnosis."""
    rows = [
        [
            cause.id,
            cause.text,
            "; ".join(
                f"{key} = {' ± '.join(format_pair(*pair))}"
                for key, pair in cause.parameters.items()
            ),
            format_number(cause.force, 3),
            format_number(cause.chi2_drop, 4),
            format_number(cause.probability, 3),
        ]
        for cause in (*found.causes, *found.negligible)
    ]
    columns = ("effect", "", "numbers [SI]", "force [N]", "drop of -2 log L", "probability")
    tables = [Table("Causes, and what is too small to matter", columns, rows)] if rows else []
    gain = found.gain
    text = (
        f"On stretches held out the error falls from {format_number(gain.before, 3)} to "
        f"{format_number(gain.after, 3)} standard deviations of the noise.",
    )
    sections = [Section("Causes", text, tables)]
    sections.append(
        Section(
            "Parameters",
            (),
            [_tabulate_parameters(found.fit), *_tabulate_open(found.fit)],
            _draw_fit(found.fit, found.plain) if pictures else (),
        )
    )
    return Report("Diagnosis of an axis", [*found.summarise()], sections)


def describe_motion(moved: AxisTrajectory, measured: NDArray | None) -> dict:
    """Return what result.json holds of a simulated motion."""
    deviation = None if measured is None else moved.position - measured
    return {
        "kind": "axis",
        "samples": len(moved.time),
        "final_position_m": float(moved.position[-1]),
        "peak_speed_m_per_s": moved.peak_speed,
        "events": [{"event": kind, "time_s": when} for kind, when in moved.events],
        "derivatives": {
            "final_position_m": {x: float(d[-1]) for x, d in moved.derivatives.items()}
        },
        "rms_deviation_m": None
        if deviation is None
        else float(np.sqrt(np.mean((deviation - deviation.mean()) ** 2))),
    }


def report_motion(
    setup: AxisSetup,
    moved: AxisTrajectory,
    force: NDArray,
    measured: NDArray | None,
    pictures: bool,
) -> Report:
    """Return the report of a simulated motion."""
    kinds = [kind for kind, _ in moved.events]
    summary = [
        f"{len(moved.time)} samples over {moved.time[-1] - moved.time[0]:.4g} s: "
        f"{kinds.count('stick')} times to rest, {kinds.count('break-away')} break-aways, "
        f"{kinds.count('reversal')} reversals without a rest.",
        f"Peak speed {moved.peak_speed:.4g} m/s; it ends at "
        f"{to_um(float(moved.position[-1])):.7g} µm.",
    ]
    if measured is not None:
        off = moved.position - measured
        summary.append(
            f"The recording's own positions differ by {to_um(float(np.sqrt(np.mean(off**2)))):.4g} "
            "µm (rms): over a long time any disturbance adds up, see the fit for runs of their own."
        )
    rows = [
        [name, format_number(setup.values.get(name), 6), format_number(float(d[-1]))]
        for name, d in moved.derivatives.items()
    ]
    table = Table("Exact derivatives of the last position [SI]", ("", "value", "dx [m/…]"), rows)
    drawn = []
    if pictures:
        caption = "Force, position and speed over time."
        drawn.append(Picture("motion", caption, figures.draw_motion(moved, force, measured)))
    return Report("Motion of an axis", summary, [Section("Derivatives", (), [table], drawn)])


def _tabulate_parameters(fit: AxisFit) -> Table:
    rows = []
    for name in fit.list_parameters():
        value, error = fit.value(name), fit.standard_error(name)
        share = "–" if not error or not value else f"{100 * error / abs(value):.2g}"
        rows.append([name, *format_pair(value, error), share])
    rows.append(["scatter", *format_pair(fit.scatter, fit.scatter_error), "–"])
    return Table("Parameters", ("SI units", "value", "± s.e.", "%"), rows)


def _tabulate_open(fit: AxisFit) -> list[Table]:
    rows = [
        [", ".join(x["parameters"]), x["reason"], x["next_stretch"]] for x in fit.not_identifiable
    ]
    columns = ("", "why", "what would settle it")
    return [Table("Not determined by these data", columns, rows)] if rows else []


def _tabulate_correlations(fit: AxisFit) -> list[Table]:
    correlation = fit.correlation
    rows = [
        [a, b, f"{correlation[i, j]:+.3f}"]
        for i, a in enumerate(fit.names)
        for j, b in enumerate(fit.names)
        if j > i and abs(correlation[i, j]) > 0.1
    ]
    return [Table("Correlations above 0.1", ("", "and", ""), rows)] if rows else []


def _tabulate_levels(levels: Sequence[FrictionLevel]) -> Table:
    rows = [
        [x.stretch, x.condition or "–", " ± ".join(format_pair(x.coulomb, x.standard_error)),
         x.reason or ""]
        for x in levels
    ]  # fmt: skip
    return Table("Coulomb friction [N]", ("stretch", "condition", "coulomb_N", ""), rows)


def _tabulate_noise(fit: AxisFit) -> Table:
    noise = fit.noise
    rows = [
        ["encoder, white [µm]", format_number(to_um(noise.encoder), 3)],
        ["encoder, slower [µm]", format_number(to_um(noise.encoder_coloured), 3)],
        ["force that nothing explains [N]", format_number(noise.force, 3)],
        ["its probability by chance", format_number(noise.force_p_value, 2)],
    ]
    return Table("Noise", ("", "rms"), rows if not fit.imposed else rows[2:3])


def _draw_fit(fit: AxisFit, plain: AxisFit | None = None) -> list[Picture]:
    drawn = [
        Picture(
            "friction",
            "Friction over speed, forwards and backwards: what the drive gave less the force of "
            "inertia (points: means over short pieces), and the fitted law.",
            figures.draw_friction(fit),
        ),
        Picture(
            "residual",
            "Force that is left over, over the position: forwards and backwards.",
            figures.draw_residual(fit, plain),
        ),
    ]
    if not fit.imposed:
        drawn.append(
            Picture(
                "motion",
                "The stretches' motion, measured and predicted from each run's own start, and the "
                "difference.",
                figures.draw_prediction(fit),
            )
        )
    return drawn
