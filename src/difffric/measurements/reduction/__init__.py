"""F_p and d from the samples of a push, without a model of the rig.

`reduce_push` and `reduce_recordings` (`reduce`) put the steps together: `contacts` finds where the
force is more than noise and where it jumps, `landmarks` the peak, the free slide and the rest,
`release` the instant at which contact is lost for good. All of them read values off samples by
`local_polynomials`, which chooses a window for each by its standard error and its bias.

To read off something else, fit a window around it with `best_window`; its coefficients come with
their covariance.
"""
