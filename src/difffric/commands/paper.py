"""`difffric paper`: the paper's tables and figures, made anew."""

from __future__ import annotations

import difffric as df
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import Out, Quiet


def paper(out: Out = None, quiet: Quiet = False) -> None:
    """Report the paper's tables and figures, beside the differentiable model's answers."""
    check_out(out)
    with show_progress(quiet) as tell:
        found = df.studies.paper.study(tell)
        report, answer = reports.paper.report_paper(found), found.as_dict()
    print_and_write(report, answer, out)
