"""What every fit stands on: coordinates, the mixed model, and two engines that fit it.

A fit moves *coordinates*: logarithms of positive parameters, a linear scale for those that may be
zero (`rig.parameters` says which). Pushes share parameters, and each has its own mu_s, which
scatters about the shared one; that is a mixed model. The two engines differ in what they are for:

| | one fit, to all digits | many fits at once, for a comparison |
| --- | --- | --- |
| used by | `calibration`, whole recordings in `identification` | `diagnosis`, `fleet` |
| what is free | parameters, some by condition | those and the numbers of each fit's effects |
| coordinates | `coordinates` | `effect_coordinates` |
| data | `stacked_data`, rows of `residuals` | `extended_model`, Gram matrices of a push |
| recordings | `block_means.stack_even` | `block_means.stack_uneven` |
| mode | `mixed_model`, `descent`, `following` | `ensemble_refits.refit` |
| variances | `restricted_likelihood` | `ensemble.estimate_scatters`, on a grid |
| own mu_s of a push | `push_friction.rescan_push_friction` | `friction_scan.rescan_bad_pushes` |
| until all stands | `mixed_fit.settle` | `ensemble_refits.refit` |

Besides: `fisher_information` tells what pushes that were not made yet would say, `open_parameters`
which parameters a covariance leaves open, in words, and `push_rigs` gives each push its own rig.

A new parameter needs a line in `rig.parameters` and nothing here; a new effect, a line in
`rig.catalogue`. For a new kind of data add a class with `respond` to `residuals` and a function to
`stacked_data`.
"""
