"""Monitoring: follow a machine's friction push by push, and raise an alarm when something changes.

`monitor.Monitor` takes pushes one at a time; `feed.Feed` gives it the pushes of files, each once,
and keeps it in a `state_file` between runs. What happens to a push, in order:

1. `readings` turns its F_p and d into two numbers: mu_s, and a contrast that mu_s cannot explain.
2. `baseline` holds both against the pushes before of the same part and setting, which makes them
   standard normal while nothing changes.
3. `shiryaev_roberts` sums the evidence of a change in them, with a threshold that gives a stated
   mean number of pushes between false alarms.
4. `local_level` follows mu_s of the part, for the reader.
5. Over the threshold, `change_point` estimates when the change came, `alarms` keeps what was known
   before it, and `change_cause` says which parameter may have changed.

`records` holds what is remembered of each push. To have another parameter among the possible
causes, add it to `change_cause.CANDIDATES`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
