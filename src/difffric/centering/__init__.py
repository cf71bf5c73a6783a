"""Centering: bring a ring on a rotary table to the axis by pushes that land where they should.

- `ring.measure` finds how far, and in which direction, a ring's centre is off the axis, from probe
  readings that `ring_csv` reads; `ring_fit` holds the fit.
- `planning.plan` chooses speed and stroke of the next push, and says how likely it is to land
  within the tolerance. It asks `landing`, which follows pushes and finds strokes by the rig's
  model, and a `belief` of mu_s, the density that the pushes before have left.
- `loop.centre` closes the loop on a `machine`: measure, plan, push, learn mu_s, and again.

To plan one push, call `plan` with a set-up and the offset; to run a machine, give `centre` an
object with the two methods of `machine.Machine`. `machine.SimulatedMachine` stands in for one.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
