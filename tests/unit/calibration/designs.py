"""Pushes of a known rig, and the calibration that the tests of error bars start from."""

from __future__ import annotations

import difffric as df
from difffric.rig.sensors import ForceSensor
from difffric.rig.setup import Extras, Setup
from tests.reference import data as reference

CALIBRATED = ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m", "mu_s")


ALL = (*CALIBRATED, "mu_k_over_mu_s")


STROKE = 1.2e-3


PAPER = {"mass": 18.9, "mu_s": 0.141, "k": 8.0e5, "b": 1500.0, "k_v": 5.0, "stroke": STROKE}


TRUTH = reference.Rig(
    m=18.5, mu_s=0.144, ratio=0.75, k_v=14.8, k=5.07e5, b=2160.0, scatter=0.016, stroke=STROKE
)


FAST = (0.03, 0.035, 0.04, 0.05, 0.06, 0.07, 0.08)


def make_setup(truth, scatter):
    """The set-up at the truth, its scatter known."""
    rig = df.spring_damper_rig(
        mass=truth.m, mu_s=truth.mu_s, k=truth.k, b=truth.b, k_v=truth.k_v,
        mu_k_over_mu_s=truth.ratio, stroke=truth.stroke, force_sensor=ForceSensor(range=5000.0),
    )  # fmt: skip
    return Setup(rig, scatter, {"friction.mu_s_scatter": Extras(free=False)})


def calibrate(known, pushes, free=CALIBRATED):
    fit = df.fit(known, pushes, free=free, several_starts=False, use_data_mass=True)
    assert fit.converged, fit
    return fit
