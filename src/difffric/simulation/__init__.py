"""Equation (2) over a push: its segments and events, the peak force F_p and the free-sliding
distance d, and their exact derivatives.

A push is a sequence of modes (stuck, closing, rebounding, free) with an event between each two;
`events` names both, how a push went, and why something of it may not exist. Which module serves
depends on what is asked:

- F_p, d and the regime of one push: `observables.observe`. It can be mapped, compiled and
  differentiated.
- The same of many pushes as NumPy arrays, on all cores: `batch.observe_batch`.
- The same of some thousand pushes at most, by NumPy and without a compiled program, where every
  law is affine or the speed alone bends friction: `columns.observe_columns`.
- Derivatives by every parameter, and the distance to the next regime: `sensitivities`.
- Force, position and speed at any time: `trajectory.simulate`.
- Curves over speed and mu_s: `families.family`.

Three integrators follow a push. `closed_form.ClosedForm` solves the legs of `segments` on paper
where every law is affine: exact to rounding, and by far the fastest. `stepping` takes Runge-Kutta
steps with exact events for laws of any kind, compiled; and by NumPy, leg by leg, where friction
bends with the speed (`stepping.stepped_legs`, within `columns`). `diffrax_reference.Diffrax` is the
slow reference that tests hold both against. A rig chooses by `segments.default_integrator`; a user
may name one.

The physics itself stands elsewhere: laws and force balance in `rig`. `dynamics` takes from them the
rates and guards that `stepping` needs, `oscillator` the two closed forms, and a `leg` is what an
integrator of `segments` answers with.

A new law needs nothing here as long as it is smooth within a mode. A new event is a member of
`events.Event`, a guard in `dynamics.Motion.guards`, and a function in `stepping.transitions` that
says what it changes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
