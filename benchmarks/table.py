"""The benchmarks' results as Markdown, between two marks of the page on performance, and its
figures beside it.

python -m benchmarks.table .benchmarks/latest.json [docs/performance.md]
"""

from __future__ import annotations

import json
import re
import sys
from itertools import groupby
from pathlib import Path

from benchmarks import figures

START, END = "<!-- bench:start -->", "<!-- bench:end -->"
PAGE = Path("docs/performance.md")
HEADING = "# Performance"
READING = (
    "Times are medians, the fastest in brackets; × is the ratio of medians, the first row of "
    "each table being 1. The first call includes compilation (a whole process: an empty "
    "cache). Errors are the worst relative ones, against difffric's closed form; its own are "
    "against numba's, and those of an identification against the truth. JAX's asynchronous "
    "dispatch is off (`jax_cpu_enable_async_dispatch`)."
)


def seconds(value: float) -> str:
    """A duration with three digits."""
    for unit, scale in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        # Rounded first: 999.6 ms is 1 s.
        if value >= 0.9995 * scale:
            return f"{float(f'{value / scale:.3g}'):g} {unit}"
    return f"{value / 1e-6:.2g} µs" if value >= 1e-8 else f"{value / 1e-9:.2g} ns"


def ratio(value: float) -> str:
    """A ratio with as many digits as timings deserve."""
    if value >= 100:
        return f"{float(f'{value:.2g}'):,.0f}".replace(",", " ")
    return f"{value:.2g}"


def machine(info: dict) -> str:
    """What it ran on, in one line; no host name."""
    brand = info.get("cpu", {}).get("brand_raw", info.get("machine", "unknown"))
    packages = [f"{name} {v}" for name, v in info.get("packages", {}).items() if v]
    system = info.get("system", "")
    return f"{info.get('cores', '?')} CPU cores ({brand}), {system}, " + ", ".join(
        [f"Python {info['python_version']}", *packages]
    )


def table(group: str, rows: list[dict]) -> str:
    """One comparison; the row that is the reference first."""
    rows = sorted(rows, key=lambda r: not r["extra_info"]["is_reference"])
    reference = next((r for r in rows if r["extra_info"]["is_reference"]), None)
    names = next((r["extra_info"]["names"] for r in rows if r["extra_info"]["names"]), [])
    columns = ["", "time", "×", "first call"]
    if names:
        columns.append(f"worst error of {', '.join(names)}")
    lines = [f"### {group.split('. ', 1)[-1]}", "", _line(columns), _line(["---"] * len(columns))]
    for r in rows:
        info, points = r["extra_info"], r["extra_info"]["points"]
        median, best = (r["stats"][key] / points for key in ("median", "min"))
        per_call = "–"
        if reference is not None:
            whole = reference["stats"]["median"] / reference["extra_info"]["points"]
            per_call = "1" if r is reference else ratio(median / whole)
        cells = [
            info["contender"],
            f"{seconds(median)} ({seconds(best)})",
            per_call,
            seconds(info["first_call_s"]),
        ]
        if names:
            cells.append(", ".join(f"{e:.0e}" if e else "0" for e in info.get("errors", [])))
        lines.append(_line(cells))
    return "\n".join(lines)


def scaling(group: str, rows: list[dict]) -> str:
    """One comparison over sizes: a row a contender, a column a size."""
    sizes = sorted({r["extra_info"]["points"] for r in rows})
    by = {(r["extra_info"]["contender"], r["extra_info"]["points"]): r for r in rows}
    head = ["", *(f"{size:,}".replace(",", " ") for size in sizes)]
    lines = [f"### {group.split('. ', 1)[-1]}", "", _line(head), _line(["---"] * len(head))]
    for contender in dict.fromkeys(name for name, _ in by):
        found = [by.get((contender, size)) for size in sizes]
        cells = [
            "–" if r is None else seconds(r["stats"]["median"] / n)
            for r, n in zip(found, sizes, strict=True)
        ]
        lines.append(_line([contender, *cells]))
    return "\n".join(
        [*lines, "", *(f"![{alt}](images/{name})" for name, alt in figures.FIGURES.items())]
    )


def _line(cells):
    return "| " + " | ".join(cells) + " |"


def markdown(results: dict) -> str:
    """All comparisons, with the machine."""
    benchmarks = sorted(results["benchmarks"], key=lambda b: b["group"])
    groups = [
        (scaling if g == figures.SCALING else table)(g, list(rows))
        for g, rows in groupby(benchmarks, key=lambda b: b["group"])
    ]
    day = results["datetime"][:10]
    head = f"Measured on {day} with `make bench`: {machine(results['machine_info'])}. {READING}"
    return "\n\n".join([head, *groups])


def into(page: str, text: str) -> str:
    """The page with the text between its marks; they are added at its end where missing."""
    block = f"{START}\n{text}\n{END}"
    marked = re.compile(re.escape(START) + ".*?" + re.escape(END), re.DOTALL)
    if marked.search(page):
        return marked.sub(lambda _: block, page)
    return f"{page.rstrip() or HEADING}\n\n## Measured\n\n{block}\n"


def main(arguments: list[str]) -> int:
    """Read the results, write the page."""
    if not 1 <= len(arguments) <= 2:
        print(__doc__, file=sys.stderr)
        return 2
    results = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
    page = Path(arguments[1]) if len(arguments) == 2 else PAGE
    before = page.read_text(encoding="utf-8") if page.exists() else ""
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(into(before, markdown(results)), encoding="utf-8")
    drawn = figures.draw(results, page.parent / "images")
    print(f"{len(results['benchmarks'])} results into {page}, {len(drawn)} figures beside it")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
