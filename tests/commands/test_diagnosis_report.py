"""The figures and words of a diagnosis that found nothing."""

from types import SimpleNamespace

import numpy as np

from difffric.commands.figures.diagnose import draw_misfit, draw_residuals
from difffric.commands.reports.diagnose import report_diagnosis
from difffric.diagnosis.verdict import ADEQUATE, Cause, HeldOutGain

N, BLOCKS = 3, 20


def make_diagnosis(size=1.0):
    """A diagnosis of three pushes without a cause, the residuals of which have this size."""
    residual = size * np.random.default_rng(1).standard_normal((1, N, 2, BLOCKS))
    fits = SimpleNamespace(residual=residual)
    lack = SimpleNamespace(chi2=(residual[0] ** 2).sum(axis=2))
    t = np.tile(np.linspace(-0.01, 0.2, BLOCKS + 1), (N, 1))
    first = np.tile(np.arange(BLOCKS), (N, 1))
    blocks = SimpleNamespace(t=t, first=first, second=first + 1, a=np.ones((N, BLOCKS)))
    model = SimpleNamespace(pushes=SimpleNamespace(data=(blocks, blocks)))
    task = SimpleNamespace(model=model, counts=np.full((N, 2), BLOCKS))
    data = SimpleNamespace(
        task=task, measured=SimpleNamespace(velocity=np.array([0.01, 0.03, 0.08]))
    )
    state = SimpleNamespace(
        data=data, plain=fits, extended=fits, lack_before=lack, lack_after=lack
    )  # without a cause the extended model is the plain one
    more = dict.fromkeys(("negligible", "certificates", "not_visible", "experiments", "notes"), ())
    return SimpleNamespace(
        verdict=ADEQUATE,
        causes=(),
        state=state,
        used_recordings=True,
        considered=(make_cause("force_gain", 2.4, 0.5), make_cause("initial_gap", 3e-8, 1.0)),
        gain=HeldOutGain(1.014, 1.014, 0.998),
        remaining=None,
        location=None,
        impossible={},
        misfit=(),
        **more,
    )


def make_cause(effect, drop, p_value):
    """An effect that was tried alone."""
    sizes = {"x": (drop, 0.1)}
    return Cause(effect, "contact", "", None, (), sizes, drop, drop, p_value, heldout_gain=0.1)


def test_effects_that_are_not_significant_do_not_read_as_findings():
    report = report_diagnosis(make_diagnosis(), "difffric identify a", pictures=False)
    (section,) = report.sections
    assert section.tables[0].caption.endswith("; none is significant (p-value below 0.001)")
    assert [row[0] for row in section.tables[0].rows] == ["force_gain"]  # the gap stayed at zero
    assert report.summary[-1].endswith("is 1.01 times the noise; the noise floor is 0.998.")
    assert report.command == "difffric identify a"
    assert make_cause("tilt", 1.0, 1.0).as_dict()["probability"] is None


def test_the_residuals_of_an_adequate_model_are_drawn():
    found = make_diagnosis()
    axes = draw_residuals(found).axes
    assert len(axes) == 2 * N
    for ax in axes:
        curves = [line for line in ax.lines if len(line.get_xdata()) == BLOCKS]
        assert [line.get_label() for line in curves] == ["_plain model"]
        assert np.ptp(curves[0].get_ydata()) > 1


def test_the_axis_of_misfits_that_are_alike_has_plain_numbers():
    assert [ax.get_yscale() for ax in draw_misfit(make_diagnosis()).axes] == ["linear", "linear"]
    one = make_diagnosis()
    one.state.lack_before.chi2[0] *= 1000
    assert [ax.get_yscale() for ax in draw_misfit(one).axes] == ["log", "log"]
