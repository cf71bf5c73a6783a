"""A table within the width of a terminal: numbers stay whole, texts wrap, names get shorter, and
what is still too wide is continued below."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Group
from rich.table import Table as RichTable
from rich.text import Text

from difffric.commands.layout.table_columns import holds_numbers, is_missing, leave_out_empty
from difffric.name_text import make_printable, shorten_name

_TEXT = 22
"""Characters that a column of texts needs to be readable; shorter ones are names."""
_WORDS = 3
"""Words from which on it is a text, and no name."""
_NAMES = (24, 16, 12)
"""Letters that names are shortened to, one after the other, until a table is narrow enough."""
_EDGES = 2
"""Characters beside a table."""


@dataclass
class _Column:
    """One column: its heading, its cells, and the width that it is given."""

    heading: str
    cells: list[str]
    numbers: bool
    width: int = field(init=False)

    def __post_init__(self) -> None:
        self.width = max(self.longest, cell_len(self.heading))

    @property
    def longest(self) -> int:
        """Characters of the longest cell."""
        return max(map(cell_len, self.cells), default=0)

    @property
    def wraps(self) -> bool:
        """Whether its cells are texts, which may go on in another line."""
        return not self.numbers and any(
            len(x) > _TEXT and len(x.split()) >= _WORDS for x in self.cells
        )

    def wrap_heading(self) -> None:
        """Make room by a heading of several lines."""
        words = max(map(cell_len, self.heading.split()), default=0)
        self.width = max(self.longest, words)

    def shorten(self, most: int) -> list[str]:
        """Return the cells without the middle of long names; numbers and texts as they are."""
        if self.numbers or self.wraps:
            return self.cells
        return [shorten_name(x, most) if cell_len(x) > most else x for x in self.cells]


def lay_out(
    caption: str, columns: Sequence[str], rows: Sequence[Sequence[str]], width: int
) -> list[Group]:
    """Return a table as a terminal of so many columns shows it: one, or several below each other
    that begin with the same column."""
    columns, rows = leave_out_empty(columns, rows)
    shown = [
        _Column(make_printable(heading), [make_printable(row[j]) for row in rows], False)
        for j, heading in enumerate(columns)
    ]
    for one in shown:
        one.numbers = holds_numbers(one.cells)
    _make_narrow(shown, width)
    return [_draw(caption, block, i > 0) for i, block in enumerate(_split(shown, width))]


def _measure(columns: Sequence[_Column]) -> int:
    return sum(one.width for one in columns) + len(columns) - 1 + _EDGES


def _make_narrow(columns: Sequence[_Column], width: int) -> None:
    """Give each column a width, so that all fit beside each other if they can."""
    if _measure(columns) <= width:
        return
    for one in columns:
        one.wrap_heading()
    texts = [one for one in columns if one.wraps]
    for one in texts:
        one.width = _find_least(one)
    whole = [one.cells for one in columns]
    # As short as it must be; where nothing helps, the table is split, and names are nearly whole.
    for most in (*_NAMES, _NAMES[0]):
        if _measure(columns) <= width:
            break
        for one, cells in zip(columns, whole, strict=True):
            one.cells = cells
            one.cells = one.shorten(most)
            if not one.wraps:
                one.wrap_heading()
    for one in texts:  # what is left over is theirs
        spare = width - _measure(columns)
        one.width += max(0, min(spare, max(one.longest, cell_len(one.heading)) - one.width))


def _find_least(one: _Column) -> int:
    """Characters that a column of texts cannot do without."""
    words = [cell_len(word) for x in (*one.cells, one.heading) for word in x.split()]
    return min(max(_TEXT, max(words, default=0)), 2 * _TEXT)


def _split(columns: list[_Column], width: int) -> list[list[_Column]]:
    """Return the columns in blocks that are narrow enough, each with the first column."""
    first, *rest = columns
    blocks = [[first]]
    for one in rest:
        if len(blocks[-1]) > 1 and _measure([*blocks[-1], one]) > width:
            blocks.append([first])
        blocks[-1].append(one)
    # Texts that stand alone have more room; the first column is in every block, as wide as each
    # leaves it.
    blocks = [[copy(one) for one in block] for block in blocks]
    for block in blocks:
        for one in (x for x in block if x.wraps):
            one.width = max(8, min(one.longest, one.width + width - _measure(block)))
    return blocks


def _draw(caption: str, columns: Sequence[_Column], continued: bool) -> Group:
    """Return one block; of a continued one without rows that have nothing to add."""
    shown = RichTable(
        box=SIMPLE_HEAD,
        padding=0,
        pad_edge=False,
        collapse_padding=True,
    )
    for one in columns:
        justify = "right" if one.numbers else "left"
        shown.add_column(Text(one.heading), justify=justify, overflow="fold", width=one.width)
    for name, *row in zip(*(one.cells for one in columns), strict=True):
        if not (continued and all(map(is_missing, row))):
            shown.add_row(*map(Text, (name, *row)))
    # Not as the table's title, which would be squeezed into the width of a narrow one.
    title = Text(make_printable(caption) + " (continued)" * continued, style="bold")
    return Group(title, shown)
