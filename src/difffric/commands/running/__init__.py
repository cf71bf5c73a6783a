"""How a command runs, whatever it does: what it shows meanwhile, and how it ends early.

- `progress_display` shows on standard error what goes on, how far it is, what is being compiled and
  the time that remains, which `remaining_time` estimates from how the work went the last time;
  `durations` keeps that in the user's cache folder.
- `interruption` ends a command within a second of Ctrl-C, also where compiled code runs: with what
  is known so far, and without half a file.
- `last_error` keeps what an unexpected failure said; `report_bug`, a command, puts it together with
  `versions` for who can mend it, without the names of the user's files.
"""
