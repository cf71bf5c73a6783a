"""The distance of a free slide from mu_s, its release speed and k_v, of any kind of number."""

from __future__ import annotations

from typing import Any

from difffric.compute import arrays as xp
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.oscillator import ViscousSlide

K_V = "k_v_N_s_per_m"
"""The parameter that a slide depends on beside mu_s."""

STEPS = 50
"""Newton steps. From their start they approach the root from one side, and where viscosity alone
would stop the part they never arrive; a fixed number serves all slides of a batch. The bracketed
Newton iteration would end in other last digits."""


def log_distance(rig: Rig, log_mu: Any, log_v: Any, k_v: Any) -> Any:
    """log d [m] of a free slide, from log mu_s, the logarithm of the release speed [m/s] and k_v
    [N s/m]."""
    at = parameters.with_values(rig, {"mu_s": xp.exp(log_mu), K_V: k_v})
    slide = ViscousSlide(-at.free(0.0), -xp.slope(at.free, log_mu, log_v, k_v))
    return xp.log(slide.rest(xp.exp(log_v))[1])


def start_above(rig: Rig, v: Any, d: Any) -> Any:
    """A log mu_s above the root, from where Newton's steps in the logarithm go down all the way:
    without viscosity d = v^2 / (2 mu_k g)."""
    ratio = parameters.values(rig)["mu_k_over_mu_s"]
    return xp.log(v**2 / (2 * d * ratio * rig.F_N / rig.mass))
