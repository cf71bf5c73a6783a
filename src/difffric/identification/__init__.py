"""mu_s of a push: the ways to it, from the published formulas to all samples of a recording.

Which to choose:

- `estimators.identify`: of measured pushes or recordings, by every way that the data allow, each
  with its standard error. What to take unless one of the next is asked for.
- `inversion.invert`: from F_p or from d alone, with every root, or the reason why there is none.
- `fast_identifier.identifier`: one push in microseconds, for a loop that identifies while it
  controls; for rigs without a stroke.
- `live.LiveIdentifier`: pushes that are commanded beforehand, each answered as soon as it ended.
- `controller`: polynomials in C, for a controller that has neither Python nor the model.
- `surrogates`: equations (3) to (7) as published, with their straight lines and powers.

How `identify` goes, one room after the other: `resolved_pushes` looks up once what is known of each
push (`ResolvedPushes`: the model at its mass, stroke and condition, the errors of its readings, the
calibration's covariance); `inversion` finds mu_s from F_p and from d, each crossing by `crossing`;
`combination` takes both together, as arrays over the pushes, with the errors of `standard_errors`;
`estimates` has what comes out. A free slide goes through `free_slide`, a recording through
`whole_recording` too. A fleet and the live identifier go the same way. `push_models` is the model
of many pushes over mu_s; `tabulated_model` the model of one, on a grid that was solved beforehand.

Two ways stay outside, as they answer another question: `centering.loop` weighs every mu_s by its
likelihood, as a part that friction held has no mu_s to be inverted; `monitoring.readings` splits
the two readings into a best mu_s and a contrast that is independent of it, and takes the roots and
the errors from here.

To add a way: a module with a function from `ResolvedPushes` to `Estimates`, a field of
`PushFriction` and its line in `WAYS`, and its step in `identify`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
