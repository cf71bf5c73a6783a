"""The pictures of the reports, one module for each report that has some.

Each `draw_...` takes what was found and returns a matplotlib `Figure`, which belongs to no window:
`page` writes it, and a notebook shows it. `style` has what they share, the colours, the marks and
`make_figure`, and imports nothing of ours, so that a ring's picture loads no calibration.

The modules are loaded on first use: `figures.fit.draw_pushes(...)`. A new picture is a `draw_...`
function here and a `Picture` in a report; a new module is listed in `__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
