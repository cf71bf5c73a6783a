"""`difffric report-bug`: what a report of a fault needs, as Markdown."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_HEAD = """\
## What I did, what I expected, what came instead

(please write it here)

## Versions

```text
{versions}
```

## The last unexpected failure

{error}

Names of files are left out (`<name 1>.csv`), and no measured data were collected. The error's own
words may tell a number or a name: please read them before you send this.
"""


def report_bug(
    out: Annotated[Path | None, typer.Option(help="file for it; else it is printed")] = None,
) -> None:
    """Collect the versions and the last error, ready for a report."""
    # Here, as help needs neither.
    from difffric.atomic_files import write_whole
    from difffric.commands.running.last_error import read_error
    from difffric.commands.running.versions import list_versions

    error = read_error() or "None was kept."
    text = _HEAD.format(versions="\n".join(list_versions()), error=error.rstrip())
    if out is None:
        typer.echo(text, nl=False)
        return
    write_whole(out, lambda file: file.write(text.encode()))
    typer.echo(f"written to {out}")
