"""A first set-up: what is said of a rig, and k and b guessed from its own pushes."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray

import difffric as df
from difffric.commands.first_steps.setup_text import Line, format_tables
from difffric.commands.options import require_positive
from difffric.errors import InputError
from difffric.measurements.checks import MASS_TOLERANCE
from difffric.measurements.load_file import load
from difffric.measurements.noise import Noise
from difffric.measurements.pushes import Pushes
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.rig.rig import spring_damper_rig
from difffric.rig.setup_toml import parse_setup
from difffric.simulation.columns import observe_columns
from difffric.units import GRAVITY, MV, from_mm, to_mm, to_um

_RATIO = 0.75
"""mu_k / mu_s, unless a fit says otherwise: the paper's."""
_PUSHES = 8
"""Pushes that a guess looks at, evenly over the speeds: more do not make it better."""
_STIFFNESS = np.geomspace(1e4, 1e8, 41)
"""[N/m], in steps of a quarter"""
_DAMPING = np.array([0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0])
"""damping ratios b / (2 sqrt(k m))"""
_FRICTION = np.array([0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4, 0.56, 0.8])
"""mu_s, where no recording tells it"""
_NO_STROKE = (
    "",
    "# [pusher]",
    "# stroke_mm = 2.0             # give the travel of the pusher: d depends on it at low speed",
)
"""What stands for the pusher where no stroke is known: its place, and why it matters."""
_FILE, _ASSUMED = "from the file", "assumed: put the value of your data sheet"
"""Where a number comes from, if no option gives it."""
_SENSITIVITY, _RANGE, _RESOLUTION = 11.2, 446.0, 0.02
"""Usual sensors: [mV/N], [N], [um]."""
_WORST = 1.0
"""Squared logarithm of a ratio that a distance which the model does not give counts as: it is the
force that tells k and b, and distances near the edge of sticking tell little."""


@dataclass(frozen=True)
class FirstNumbers:
    """What a person says of a rig; None: not said."""

    mass_kg: float | None
    stroke_mm: float | None
    sensitivity_mV_per_N: float | None
    range_N: float | None
    resolution_um: float | None


@dataclass(frozen=True)
class _Number:
    """A number of a first set-up, and where it comes from."""

    value: float
    origin: str

    @classmethod
    def choose(cls, given: float | None, option: str, usual: float) -> _Number:
        """The number that an option gives, or else the usual one of a sensor."""
        return cls(usual, _ASSUMED) if given is None else cls(given, f"given with {option}")

    @property
    def text(self) -> str:
        """As the set-up has it."""
        return f"{self.value:.6g}"


def write_first_setup(
    data: Path, said: FirstNumbers, names: dict[str, str], skip_bad: bool
) -> tuple[str, str]:
    """(the text of a set-up for the pushes of a file, where its numbers come from, in words).
    `names`: what the file calls a column or channel, by our name.

    Raises `InputError` where the file cannot be used, or tells no mass, or no force.
    """
    loaded = load(data, skip_bad=skip_bad, channels=names)
    weighed = _ask_for_mass(loaded, said.mass_kg)
    mass = weighed.value
    sensitivity = _Number.choose(said.sensitivity_mV_per_N, "--sensitivity-mv-per-n", _SENSITIVITY)
    most = _Number.choose(said.range_N, "--range-n", _RANGE)
    resolution = _Number.choose(said.resolution_um, "--resolution-um", _RESOLUTION)
    noise: dict[str, Noise | None] = {}
    if isinstance(loaded, df.Recordings):
        newtons = loaded.in_newtons(MV * sensitivity.value)
        reduction = reduce_recordings(newtons, skip_bad=skip_bad)
        pushes, known = reduction.pushes, [x.deceleration for x in reduction.details]
        noise = {k: getattr(reduction.details[0], f"noise_{k}") for k in ("force", "position")}
    else:
        pushes, known = loaded, []
    if pushes.free_slides:
        raise InputError(f"{data}: free slides tell neither k nor b: expected pushes")
    travel = None if said.stroke_mm is None else _Number(said.stroke_mm, "given with --stroke-mm")
    if travel is None and np.isfinite(pushes.stroke).all():
        travel = _Number(to_mm(float(pushes.stroke[0])), _FILE)
    stroke = None if travel is None else from_mm(travel.value)
    mu_s, k, b = guess_contact(pushes, mass, stroke, known)
    lines: dict[str, list[Line]] = {
        "part": [("mass_kg", weighed.text, f"{weighed.origin}; every mu_s depends on it")],
        "friction": [
            ("mu_s", f"{mu_s:.3g}", "a guess from these pushes; a fit finds it for each condition"),
            ("mu_k_over_mu_s", f"{_RATIO}", "the usual ratio; a fit holds it by default"),
            ("k_v_N_s_per_m", "0.0", "viscous friction; a fit finds it"),
        ],
        "contact": [
            ("k_N_per_m", f"{k:.2g}", "a guess from these pushes; a fit finds it"),
            ("b_N_s_per_m", f"{b:.2g}", "a guess from these pushes; a fit finds it"),
        ],
        "pusher": []
        if travel is None
        else [("stroke_mm", travel.text, f"{travel.origin}; compare it with your rig")],
        "force_sensor": [
            ("sensitivity_mV_per_N", sensitivity.text, sensitivity.origin),
            ("range_N", most.text, f"{most.origin}; a force that reaches it is saturated"),
            *_write_noise("noise_N", noise.get("force"), 1.0),
        ],
        "probe": [
            ("resolution_um", resolution.text, resolution.origin),
            *_write_noise("noise_um", noise.get("position"), to_um(1.0)),
        ],
        "files": [
            (key, json.dumps(name, ensure_ascii=False), "its name in the files")
            for key, name in names.items()
        ],
    }
    text = format_tables(lines, data, {"pusher": _NO_STROKE})
    parse_setup(text)
    named = (
        ("mass", weighed, "kg"), ("stroke", travel, "mm"), ("sensitivity", sensitivity, "mV/N"),
        ("range", most, "N"), ("resolution", resolution, "µm"),
    )  # fmt: skip
    words = []
    for origin, lead in ((_FILE, _FILE), (_ASSUMED, "assumed, until you read your data sheets")):
        those = [f"{what} {x.text} {unit}" for what, x, unit in named if x and x.origin == origin]
        if those:
            words.append(f"{lead}: {', '.join(those)}")
    words.append(f"guessed from the pushes: mu_s {mu_s:.2g}, k {k:.2g} N/m, b {b:.2g} N s/m")
    return text, "\n".join(words)


def guess_contact(
    pushes: Pushes, mass: float, stroke: float | None, decelerations: list[float]
) -> tuple[float, float, float]:
    """(mu_s, k [N/m], b [N s/m]) that come nearest to the measured forces and distances, on a grid.

    mu_s is that of the free slides' `decelerations` [m/s^2] where there are any, else it is on the
    grid too.

    Raises `InputError` where no force was measured.
    """
    known = np.flatnonzero(np.isfinite(pushes.peak_force))
    if not len(known):
        raise InputError(f"{pushes.source}: no force in it: expected pushes with a force".strip())
    order = known[np.argsort(pushes.velocity[known], kind="stable")]
    few = pushes.select(
        order[np.unique(np.linspace(0, len(order) - 1, _PUSHES).round().astype(int))]
    )
    slowing = np.array(decelerations, float)
    slowing = slowing[np.isfinite(slowing) & (slowing > 0)]
    friction = np.array([np.median(slowing) / GRAVITY / _RATIO]) if len(slowing) else _FRICTION
    mu, k, zeta = (x.ravel() for x in np.meshgrid(friction, _STIFFNESS, _DAMPING, indexing="ij"))
    best = int(np.argmin(_measure_misfit(few, mass, stroke, mu, k, zeta)))
    return float(mu[best]), float(k[best]), float(2 * zeta[best] * np.sqrt(k[best] * mass))


def _measure_misfit(
    few: Pushes, mass: float, stroke: float | None, mu: Any, k: Any, zeta: Any
) -> NDArray:
    """(n,) mean squared logarithm of model over measured, of n triples."""
    n, total = len(mu), np.zeros(len(mu))
    for i in range(len(few)):
        rig = spring_damper_rig(
            mass=mass, mu_s=mu, k=k, b=2 * zeta * np.sqrt(k * mass), stroke=stroke
        )
        seen = observe_columns(rig, np.full(n, few.velocity[i]))
        with np.errstate(all="ignore"):
            F = np.log(np.asarray(seen.peak_force) / few.peak_force[i]) ** 2
            d = np.log(np.asarray(seen.sliding_distance) / few.sliding_distance[i]) ** 2
        total += np.nan_to_num(F, nan=_WORST)
        if np.isfinite(few.sliding_distance[i]):
            total += 0.1 * np.minimum(np.nan_to_num(d, nan=_WORST), _WORST)
    return total / len(few)


def _ask_for_mass(data: Pushes | Any, given: float | None) -> _Number:
    """The mass [kg] from the option, else from the data, else from who sits at the terminal.

    Raises `InputError` where none of them says it, and where the option says another mass than
    every push: all other commands would refuse such a set-up.
    """
    said = data.mass if isinstance(data, Pushes) else np.array([push.mass for push in data])
    if given is not None:
        known = said[np.isfinite(said)]
        if len(known) and not np.any(abs(known - given) <= MASS_TOLERANCE * given):
            in_grams = np.any(abs(1e3 * known - given) <= MASS_TOLERANCE * given)
            doubt = "; was it meant in grams?" if in_grams else ": expected the same, or no option"
            raise InputError(f"--mass-kg {given:.6g}: the file says {known[0]:.6g} kg{doubt}")
        return _Number(given, "given with --mass-kg")
    if np.isfinite(said).all():
        return _Number(float(np.median(said)), _FILE)
    if sys.stdin.isatty():
        answer = typer.prompt("mass of the part [kg]", type=float)
        return _Number(require_positive("mass", answer) or 1.0, "as typed")
    raise InputError("--mass-kg is missing: the data do not say the mass of the part")


def _write_noise(key: str, noise: Noise | None, scale: float) -> list[Line]:
    if noise is None or not noise.level > 0:
        return []
    return [(key, f"{scale * noise.level:.3g}", "measured in the quiet time of these pushes")]
