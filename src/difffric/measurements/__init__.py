"""Measured pushes: what a table or a recording says, whether it can be used, and how noisy it is.

- `load` (`load_file`) reads a file of either kind: a table (.csv) gives `Pushes`, one number of
  each kind a push; recordings (.tdms) give `Recordings`, samples over time, read when asked for.
- `quantities`: what may be said of a push, with its names in files, units and ranges.
- `headings`: what a name in a file means, in which unit.
- `checks`: `check_data` holds data against the rig that they are said to come from; `unit_checks`
  tells units that are plainly wrong.
- `noise`: how large the noise of a channel is, and how much one sample says about the next.
- `files`: the file formats. `reduction`: F_p and d from samples, without a model.

Which to choose: `check_data` takes either kind, and everything after it works on what it gives.
To fit a rig to recordings their samples are best; `reduction` serves where single numbers will do.

To add a quantity, give it a line in `quantities.QUANTITIES` and a field of the same name in
`Pushes` (and in `Recording`, if a recording may say it). Only `checks` knows a rig: the recorder
uses the rest of this package and must load without JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
