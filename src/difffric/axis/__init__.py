"""An axis driven by a recorded force: its friction, mass and offset, and what else it does.

    m x'' = force(t) + offset - (F_c + k_v |u|) sign(u) while it moves, up to F_s while it sticks

Nobody needs to have seen a push tip: a servo axis, its drive's force or voltage and its encoder are
enough. The way of a fit:

- `load_recording` reads files, `recordings` holds and checks the stretches; `setup` is what is
  known of the axis, `setup_file` its file, `effects` the table of what it may do beyond the
  equation.
- `one_sign_runs` cuts stretches into runs, in which the axis moves one way, so that no event has
  to be found in noisy positions; `preparation` does all that comes before a fit.
- `motion_model` is the equation, twice integrated, over all runs; `noise_model` what is noise in
  it: the encoder, force disturbances, and a friction level that each stretch has of its own.
- `search` finds the parameters, `identifiability` says what the data leave open, `breakaway` looks
  at the ends of rests, `friction_levels` at each stretch; `fit` puts all together, `result` holds
  it. `diagnosis` looks for effects and holds them against stretches left out.
- `simulation` goes the other way, from the force to the motion, by linear recursions between exact
  events; `stepped_motion` does with effects.

To add an effect: a class and a line in `effects`, and the same law in `tests/reference/axis.py`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
