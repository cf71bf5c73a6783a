"""The rig: a part on rails in front of a push tip, its laws, its effects and its set-up file.

- `force_balance`: equation (2).
- `rig`: `Rig`, which puts the laws into it; `spring_damper_rig` makes the paper's.
- `friction` (equation (1)), `contact`, `pusher`, `sensors`: the laws, and the effects, which are
  laws around a law. `free_form` has laws around a law with a curve of no particular form.
- `catalogue`: all effects by name; `extended` adds some to a rig, `universal` all of them.
- `parameters`: the one table of what is known of each parameter, and the values a rig has of them.
- `setup`: `Setup`, a rig with what is known of its numbers, and `check_rig`. `setup_toml` reads and
  writes it as a file; `quantities` are the numbers of that file, `setup_schema` its models,
  `toml_layout` its text. The simulation needs none of these four.
- `scales`: how fast, far and hard some pushes are; `number`: what a field of a rig holds.

To add a friction or contact law, subclass `AbstractFriction` or `AbstractContact`: give it its
parameters as fields in SI units, and the methods that the base class calls abstract, each smooth.
It works at once with everything that takes a rig. For a parameter to be fitted it needs a row in
`parameters`.

To add an effect, subclass the module's `Abstract...Effect` (its first field is `law`, what it does
not override is that law's own; at the null value it must be that law exactly) and give it a line in
`CATALOGUE`, which makes it known to set-ups, fits and `difffric diagnose`. CONTRIBUTING.md has
both step by step.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
