"""mu_s as polynomials for a controller: fitted to the exact model, with a bound of their error.

- `fitting.fit_predictor`: fits a `Predictor` to a rig over a `Box` of speeds and mu_s, and tells
  the error: bounded for the plain rig without a stroke, sampled for any other.
- `predictor.Predictor`: evaluates it in Python, in the same arithmetic as the C function.
- `c_code`: writes it as C99, with golden vectors that a compiled one must give.
- `domain`: where a reading determines mu_s at all.

To change what the C function answers, change `predictor_template.c` and `Predictor.predict`
together; the golden vectors hold them to each other.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
