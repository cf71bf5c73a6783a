"""`difffric family`: F_p and d over speed and mu_s."""

from __future__ import annotations

import difffric as df
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import Out, Quiet, Setup, load_rig


def family(setup: Setup, out: Out = None, quiet: Quiet = False) -> None:
    """Simulate the curve families, and report the fits (3) and (5) and their inverses."""
    check_out(out)
    rig = load_rig(setup)
    with show_progress(quiet) as tell:
        tell("simulating 494 pushes", 0.0)
        grid = df.family(rig)
    answer = reports.family.describe_family(grid)
    print_and_write(reports.family.report_family(answer, grid, rig), answer, out)
