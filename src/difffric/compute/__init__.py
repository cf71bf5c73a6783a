"""What JAX, XLA, NumPy and root finding need that has nothing to do with a push: no mechanics is
here.

Written once, run by either
: `arrays` are the functions of arrays that an equation is written with: JAX runs it, or NumPy,
  which gives exact derivatives with `dual_numbers`. `elementary_functions` are sine, arctangent,
  logarithm and quotient likewise, `written_out` what they are for JAX, so that they vectorise.
  `lanes` are its loops and choices: a lane is one of the cases that go through it together.

Compiling
: `program_cache.cache_program` compiles a function and keeps its programs on disk, in the store
  of `programs`. `xla_options.compile_soon` is the same for a large program that runs
  seldom; `xla_options.in_one_piece` makes one native function of a computation of many small loops.
  `precision.require_float64` refuses 32 bits.

Roots and minima
: `event_root.find_falling_root` for the time of an event, with exact derivatives of every order.
  `bracketed_step` is Newton's step kept in a bracket, and a search in columns of NumPy's;
  `bracketed_newton.BracketedNewton` the same as a root finder of optimistix, where no derivative
  is needed.
  `hermite` for the first root of a guard known at both ends of a step.
  `levenberg_marquardt` for a fit of many pushes within a compiled program, `arrow_jacobian` for one
  whose model alone is compiled.

Numbers
: `smooth_extension` continues a law beyond the place where it begins; `pytrees` treats a tree of
  numbers as one number.

A new module belongs here if it would read the same in a library on another subject.
"""
