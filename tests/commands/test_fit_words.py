"""What a fit says of itself in sentences, and what it tells to do next."""

import shlex
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from difffric.commands.options import ReadOptions, format_command
from difffric.commands.reports.fit_summary import advise, choose_command, summarise_fit


def make_fit(reduced_chi2=1.0, **other):
    """What the sentences take of a fit of recordings with fifty thousand samples."""
    fit = SimpleNamespace(
        reduced_chi2=reduced_chi2,
        degrees_of_freedom=50_000,
        chi2=50_000 * reduced_chi2,
        converged=True,
        spread_force=np.nan,
        spread_distance=np.nan,
        starts_at_optimum=(1, 1),
        kind="recordings",
        left_out=0,
        free=("mu_s",),
        names=("mu_s",),
        scatter=0.02,
        scatter_se=0.004,
        not_identifiable=[],
        held=(),
        mu_s=np.full(16, 0.11),
        samples=50_010,
        notes=(),
        skipped=(),
        value=lambda label: 0.11,
        standard_error=lambda label: 0.001,
    )
    vars(fit).update(other)
    return fit


@pytest.mark.parametrize(
    ("reduced_chi2", "verdict", "leads_to"),
    [
        (1.01, "the model follows the data to their noise", "identify"),
        (1.04, "to within 2 % of their noise (reduced chi-square 1.04: more than", "identify"),
        (1.08, "the model does not follow the data to their noise", "diagnose"),
    ],
)
def test_the_noise_is_known_to_two_per_cent(reduced_chi2, verdict, leads_to):
    fit = make_fit(reduced_chi2)
    assert verdict in summarise_fit(fit)[0]
    (line,) = advise(fit, None, None)
    assert f"difffric {leads_to}" in line
    assert choose_command(fit) == leads_to


def test_a_mu_s_that_is_not_determined_is_no_number():
    left_open = [{"parameters": ["mu_s", "k_v_N_s_per_m"], "reason": "traded off"}]
    said = summarise_fit(make_fit(not_identifiable=left_open, left_out=420))
    assert said[1] == "mu_s is not determined by these data."
    assert any("420 more, beside jumps of the force or speed, were left out" in x for x in said)
    assert summarise_fit(make_fit())[1] == "mu_s is 0.1100 ± 0.0010."


def test_what_did_not_converge_leads_to_no_command():
    assert choose_command(make_fit(converged=False)) == ""


def test_the_command_reads_the_same_data_in_the_same_way():
    asked = ReadOptions(skip_bad=True, channel=["force=F (N)"])
    typed = format_command(
        "diagnose", Path("my data.tdms"), Path("setup.toml"), asked, "--out", "x"
    )
    assert shlex.split(typed)[2:] == [
        "my data.tdms", "--setup", "setup.toml", "--skip-bad", "--channel", "force=F (N)",
        "--out", "x",
    ]  # fmt: skip
