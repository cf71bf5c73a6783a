"""difffric: differentiable identification of sliding friction. SI units throughout."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

_HOME = {
    "AbstractContact": "rig.contact",
    "AbstractFriction": "rig.friction",
    "Belief": "centering.belief",
    "ClosedForm": "simulation.closed_form",
    "ConstantSpeed": "rig.pusher",
    "DifffricError": "errors",
    "Diffrax": "simulation.diffrax_reference",
    "InputError": "errors",
    "Known": "centering.planning",
    "Monitor": "monitoring.monitor",
    "NumericalError": "errors",
    "Predictor": "identification.controller.predictor",
    "Pushes": "measurements.pushes",
    "Recording": "measurements.recordings",
    "Recordings": "measurements.recordings",
    "Rig": "rig.rig",
    "RungeKutta": "simulation.stepping.integrator",
    "Trajectory": "simulation.trajectory",
    "UnilateralSpringDamper": "rig.contact",
    "ViscousCoulomb": "rig.friction",
    "centre": "centering.loop",
    "diagnose": "diagnosis.procedure",
    "diagnose_fleet": "fleet.diagnose_archive",
    "extended": "rig.catalogue",
    "family": "simulation.families",
    "fit": "calibration.calibrate",
    "fit_predictor": "identification.controller.fitting",
    "identifiable": "calibration.identifiability",
    "identifier": "identification.fast_identifier",
    "identify": "identification.estimators",
    "identify_fleet": "fleet.identify_archive",
    "invert": "identification.inversion",
    "load": "measurements.load_file",
    "load_ring": "centering.ring_csv",
    "load_setup": "rig.setup_toml",
    "measure": "centering.ring",
    "next_push": "calibration.optimal_push",
    "observe": "simulation.observables",
    "observe_batch": "simulation.batch",
    "plan": "centering.planning",
    "profile": "calibration.profiles",
    "regime_margin": "simulation.sensitivities",
    "sensitivity": "simulation.sensitivities",
    "simulate": "simulation.trajectory",
    "spring_damper_rig": "rig.rig",
    "universal": "rig.catalogue",
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from difffric.calibration.calibrate import fit as fit
    from difffric.calibration.identifiability import identifiable as identifiable
    from difffric.calibration.optimal_push import next_push as next_push
    from difffric.calibration.profiles import profile as profile
    from difffric.centering.belief import Belief as Belief
    from difffric.centering.loop import centre as centre
    from difffric.centering.planning import Known as Known
    from difffric.centering.planning import plan as plan
    from difffric.centering.ring import measure as measure
    from difffric.centering.ring_csv import load_ring as load_ring
    from difffric.diagnosis.procedure import diagnose as diagnose
    from difffric.errors import DifffricError as DifffricError
    from difffric.errors import InputError as InputError
    from difffric.errors import NumericalError as NumericalError
    from difffric.fleet.diagnose_archive import diagnose_fleet as diagnose_fleet
    from difffric.fleet.identify_archive import identify_fleet as identify_fleet
    from difffric.identification.controller.fitting import fit_predictor as fit_predictor
    from difffric.identification.controller.predictor import Predictor as Predictor
    from difffric.identification.estimators import identify as identify
    from difffric.identification.fast_identifier import identifier as identifier
    from difffric.identification.inversion import invert as invert
    from difffric.measurements.load_file import load as load
    from difffric.measurements.pushes import Pushes as Pushes
    from difffric.measurements.recordings import Recording as Recording
    from difffric.measurements.recordings import Recordings as Recordings
    from difffric.monitoring.monitor import Monitor as Monitor
    from difffric.rig.catalogue import extended as extended
    from difffric.rig.catalogue import universal as universal
    from difffric.rig.contact import AbstractContact as AbstractContact
    from difffric.rig.contact import UnilateralSpringDamper as UnilateralSpringDamper
    from difffric.rig.friction import AbstractFriction as AbstractFriction
    from difffric.rig.friction import ViscousCoulomb as ViscousCoulomb
    from difffric.rig.pusher import ConstantSpeed as ConstantSpeed
    from difffric.rig.rig import Rig as Rig
    from difffric.rig.rig import spring_damper_rig as spring_damper_rig
    from difffric.rig.setup_toml import load_setup as load_setup
    from difffric.simulation.batch import observe_batch as observe_batch
    from difffric.simulation.closed_form import ClosedForm as ClosedForm
    from difffric.simulation.diffrax_reference import Diffrax as Diffrax
    from difffric.simulation.families import family as family
    from difffric.simulation.observables import observe as observe
    from difffric.simulation.sensitivities import regime_margin as regime_margin
    from difffric.simulation.sensitivities import sensitivity as sensitivity
    from difffric.simulation.stepping.integrator import RungeKutta as RungeKutta
    from difffric.simulation.trajectory import Trajectory as Trajectory
    from difffric.simulation.trajectory import simulate as simulate


def __getattr__(name: str):
    """Public names are imported when first used: a command pays only for what it needs."""
    if name not in _HOME:
        raise AttributeError(f"module 'difffric' has no attribute {name!r}")
    return getattr(importlib.import_module(f"difffric.{_HOME[name]}"), name)
