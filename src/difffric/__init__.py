"""difffric: differentiable identification of sliding friction. SI units throughout."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

_HOME = {
    "AbstractContact": "contact",
    "AbstractFriction": "friction",
    "Belief": "belief",
    "ClosedForm": "closed_form",
    "ConstantSpeed": "pusher",
    "DifffricError": "errors",
    "Diffrax": "integrate",
    "InputError": "errors",
    "Known": "planning",
    "Monitor": "monitor",
    "NumericalError": "errors",
    "Predictor": "predictor",
    "Pushes": "pushes",
    "Recording": "recordings",
    "Recordings": "recordings",
    "Rig": "rig",
    "RungeKutta": "runge_kutta",
    "Trajectory": "trajectory",
    "UnilateralSpringDamper": "contact",
    "ViscousCoulomb": "friction",
    "centre": "centering",
    "diagnose": "diagnosis",
    "diagnose_fleet": "fleet_diagnosis",
    "extended": "effects",
    "family": "families",
    "fit": "calibration",
    "fit_predictor": "predictor_fit",
    "identifiable": "identifiability",
    "identifier": "instant",
    "identify": "estimators",
    "identify_fleet": "fleet",
    "invert": "inversion",
    "load": "data_file",
    "load_ring": "ring_file",
    "load_setup": "setup_file",
    "measure": "ring",
    "next_push": "optimal_push",
    "observe": "observables",
    "observe_batch": "batch",
    "plan": "planning",
    "profile": "profiles",
    "regime_margin": "derivatives",
    "sensitivity": "derivatives",
    "simulate": "trajectory",
    "spring_damper_rig": "rig",
    "universal": "effects",
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from difffric.batch import observe_batch as observe_batch
    from difffric.belief import Belief as Belief
    from difffric.calibration import fit as fit
    from difffric.centering import centre as centre
    from difffric.closed_form import ClosedForm as ClosedForm
    from difffric.contact import AbstractContact as AbstractContact
    from difffric.contact import UnilateralSpringDamper as UnilateralSpringDamper
    from difffric.data_file import load as load
    from difffric.derivatives import regime_margin as regime_margin
    from difffric.derivatives import sensitivity as sensitivity
    from difffric.diagnosis import diagnose as diagnose
    from difffric.effects import extended as extended
    from difffric.effects import universal as universal
    from difffric.errors import DifffricError as DifffricError
    from difffric.errors import InputError as InputError
    from difffric.errors import NumericalError as NumericalError
    from difffric.estimators import identify as identify
    from difffric.families import family as family
    from difffric.fleet import identify_fleet as identify_fleet
    from difffric.fleet_diagnosis import diagnose_fleet as diagnose_fleet
    from difffric.friction import AbstractFriction as AbstractFriction
    from difffric.friction import ViscousCoulomb as ViscousCoulomb
    from difffric.identifiability import identifiable as identifiable
    from difffric.instant import identifier as identifier
    from difffric.integrate import Diffrax as Diffrax
    from difffric.inversion import invert as invert
    from difffric.monitor import Monitor as Monitor
    from difffric.observables import observe as observe
    from difffric.optimal_push import next_push as next_push
    from difffric.planning import Known as Known
    from difffric.planning import plan as plan
    from difffric.predictor import Predictor as Predictor
    from difffric.predictor_fit import fit_predictor as fit_predictor
    from difffric.profiles import profile as profile
    from difffric.pusher import ConstantSpeed as ConstantSpeed
    from difffric.pushes import Pushes as Pushes
    from difffric.recordings import Recording as Recording
    from difffric.recordings import Recordings as Recordings
    from difffric.rig import Rig as Rig
    from difffric.rig import spring_damper_rig as spring_damper_rig
    from difffric.ring import measure as measure
    from difffric.ring_file import load_ring as load_ring
    from difffric.runge_kutta import RungeKutta as RungeKutta
    from difffric.setup_file import load_setup as load_setup
    from difffric.trajectory import Trajectory as Trajectory
    from difffric.trajectory import simulate as simulate


def __getattr__(name: str):
    """Public names are imported when first used: a command pays only for what it needs."""
    if name not in _HOME:
        raise AttributeError(f"module 'difffric' has no attribute {name!r}")
    return getattr(importlib.import_module(f"difffric.{_HOME[name]}"), name)
