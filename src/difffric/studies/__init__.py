"""Studies: what the library shows of itself, and of the paper that it grew from.

- `published_tables` holds the paper's tables and formulas; `paper` says what equation (2)
  gets wrong in them, and what mends it; `next_push` which push would settle what they leave open.
  `difffric paper` prints it.
- `sampling` says what a sampling rate costs, by samples of an exact push.
- `centering_runs` centres many hidden rings on simulated machines; `other_centering` has the other
  ways that it compares with.
- `first_runs` does the work of the commands on simulated pushes, so that their programs are
  compiled beforehand. `difffric warm` prints what was made.
- `simulated_rig` puts a set-up's rig in front of a simulated card.

A study takes its set-up by argument and returns numbers; what tells them to a person stands in
`commands`, and what runs for hours in the repository's folder `studies`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
