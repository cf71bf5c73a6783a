"""The integrator for laws of any kind: Runge-Kutta steps with exact events, one loop for all modes.

`integrator.RungeKutta` is what a user names. It builds a `loop.StepLoop`, each turn of which

1. plans how far to go (`step_plan`),
2. takes a step of DOP853 (`dop853`),
3. finds the first guard that falls through zero in it, and where (`event_location`),
4. ends there by a Taylor step, or takes the step again so that it does,
5. applies what the event changes (`transitions`) to what the loop carries (`state`).

`dense_output` makes a step a function of time. What sensors see beyond the plain peak and release
is read off it stride by stride (`sensor_readout`), and `path` keeps the strides of a push to be
evaluated at any time.

Everything is traced once for all pushes of a kind of rig, so that nothing may depend on a value
but by `jnp.where`. Derivatives pass through in forward mode: step lengths are held, the Taylor step
carries those of event times.

`stepped_legs` is apart: it steps through the legs of `segments` by NumPy (`column_steps`), many
pushes side by side, where friction bends with the speed and all else is affine. Both take their
numbers from `dop853_tableau`.
"""
