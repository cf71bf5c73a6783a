"""From the force to the motion of an axis, with exact derivatives.

`simulate` takes the way that serves: `run_recursion` for a plain axis, whose equation is affine
between two events, `stepped_motion` for one with effects. Both give a `trajectory`.
"""
