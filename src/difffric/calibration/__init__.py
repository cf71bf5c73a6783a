"""Calibration: the rig's numbers from measured pushes, with their error bars.

What to call:

- `calibrate.fit` gives a `result.Fit` of a table, of whole recordings or of free slides. `print`
  shows its report (`report_text`), `Fit.as_dict` is what `result.json` holds.
- `profiles.profile` gives error bars that need not be symmetric, where those of `Fit` may mislead:
  beside a bound, and with few pushes. It costs some dozen fits a parameter.
- `identifiability.identifiable` says before a measurement what the planned pushes will determine;
  `optimal_push.next_push` says after a fit which push to make next.
- `data_comparison` sets the fitted model beside the data: by push, over time, over the speeds.

How a fit finds its optimum, in the order in which it is done:

1. `free_parameters` chooses what is free.
2. A table, or free slides: `multistart` descends from several starts (`table_starts`), follows the
   best to the end, looks for others in `other_basins`, lets the fits compete by the marginal
   likelihood, and brings the best to the optimum of that (`marginal.polish`). Each push's own mu_s
   may jump between `mu_s_branches`; `batched_answers` computes F_p and d at hundreds of points at
   once.
3. Recordings: `recording_search` starts from where their peaks and distances lead, and fits every
   sample.
4. `result_builder` turns the settled point into a `Fit`.

What is solved at each point, the mixed model, stands in `difffric.estimation`.

To add a kind of data, give its push a `respond` in `estimation.residuals`, stack the pushes in
`estimation.stacked_data`, call that in `calibrate`, and say in `free_parameters` what such pushes
cannot show; CONTRIBUTING has all the steps.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
