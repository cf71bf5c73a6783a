"""Commands for the first minutes with data of one's own, before anybody waits for a fit.

- `init` writes a first set-up, with k and b guessed from the pushes.
- `check` reads measured pushes, reduces them, and shows what a fit would be given: what was read
  and converted, traces with their landmarks, noise, what is missing, and what could be determined.

They lie apart as the folder above is full; `main.load_command` looks here for what is not there.
"""
