"""Fleets: archives of many files from many rigs, identified or diagnosed in one go.

`archive.find_files` lists the files of an archive and the rig that each belongs to. From there two
ways lead on, and both go on where a run that was killed, or one on a smaller archive, has ended:

- `identify_archive.identify_fleet` writes mu_s of every push into one Parquet data set. It reads
  files by `features` (F_p, d and noise, no model) and identifies them by `columns`, thousands of
  pushes of all rigs in one program. Choose it for trends, and for data of any size.
- `diagnose_archive.diagnose_fleet` diagnoses each rig (`member`) on a `sample` of its pushes. Then
  `shared_effects` says which effects rigs share and how large they are, by `meta_analysis`, and
  which rigs differ; `verdict` puts that in words. Choose it where the model does not fit.

Both hand their tasks to `workers`: this process, several new ones, or a dask cluster. A new kind of
work on a fleet is a function of one task, which writes its answer whole and returns what went wrong
in place of raising it, and a loop like those over `run(function, tasks)`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
