"""How a report is laid out: as one page for a browser, and on a terminal.

`reports` says what is told; what it looks like is held here, once for all commands.

- `table_columns`: which columns of a table hold numbers, and which say nothing and are left out.
- `terminal_tables`: a table within the width of a terminal.
- `svg_figure`: a matplotlib figure as SVG in a page, with what a script needs to zoom it and to
  read values out.
- `dark_colours`: a colour for dark ground, as well to see there as the given one on white.
- `page.html`, `page.css`, `tables.js`, `figures.js`: the page itself. It loads nothing from
  elsewhere, and shows all of its contents where no script runs.
"""
