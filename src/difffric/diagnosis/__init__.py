"""What the rig's simulation gets wrong in measured pushes, the cause, and what mending it gains.

`diagnose` in `procedure` is the way in; its answer is a `Diagnosis` (`verdict`). What it does, in
order, and which module holds each step:

1. `start` checks the data and fits the plain set-up; `data` sets measured pushes against it and
   says which effects they cannot show. `extended_setup` strips the effects that the set-up has
   already.
2. `lack_of_fit` tests whether the plain model leaves more than noise, and whether so much that
   nothing linear is to be trusted.
3. `score_test` predicts for each effect, without a refit, how much it would explain.
4. `exploration` finds the effects that explain most and refits them, from where the score tests
   lead and from the sizes of `starting_values`, with `shape_scan` for wavelengths and places.
5. `cross_validation` says whether the best of them predicts held-out pushes better. If it does and
   is significant, it joins the model, `start` looks for a better optimum of that model while it is
   not at its noise floor, and `procedure` begins again at 3, up to three
   causes; those that later ones made needless are dropped. `verdict` says what each changes.
6. `alternatives` puts in each cause's place what could as well stand there, and
   `impossible_measurements` finds distances that no plain model gives.
7. `conclusion` turns what was found into the verdict: `location` finds the component where no
   effect explains the misfit, `misfit` says where in a push it sits, `next_experiment` which push
   would tell more.

The fits themselves, many at once, are those of `estimation`.

How an effect comes to be looked for: every effect of `rig.catalogue` is, from its typical size. One
with a derivative at its null is listed in `starting_values.SMOOTH_AT_NULL` and so has a score test;
`starting_values` holds the grid of its sizes; one with a wavelength or a place stands in
`shape_scan.SHAPED` instead. `data` says with which data it cannot be seen. CONTRIBUTING, "Add an
effect", has the whole recipe.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
