"""The stored pushes with effects, as rigs of the library: the answers to them, and how far off."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric.rig import catalogue
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.observables import Observables, observe
from tests.reference.effect_cases import FILE
from tests.reference.effect_parameters import BASE, FIXED, vector

STORED = dict(np.load(FILE))
NAMES = [str(name) for name in STORED["names"]]
GROUPS = [str(name) for name in STORED["groups"]]
BY = [str(name) for name in STORED["derivative_names"]]
EVERY = tuple(effect for effect in catalogue.CATALOGUE if effect != "presliding")
GIVEN = {"friction_drift.place": "share", "static_dwell.rest_s": "rest"}
BLOCK = 64
"""Pushes at a time: a block takes as long as its longest push."""

OPTIONS = {"xla_backend_optimization_level": 0}
"""Compiles in half the time, and runs three times as long."""


def rows_of(group: str, count: int | None = None) -> NDArray:
    """The first stored rows of a group."""
    return np.flatnonzero(STORED["group"] == GROUPS.index(group))[:count]


def laws_of(group: str) -> tuple[str, ...]:
    """The effects that a group's rigs need."""
    return EVERY if group == "all" else tuple(catalogue.CATALOGUE.keys() & {group})


def built(numbers, ids: Sequence[str]):
    """(rig, velocity) of a row of stored parameters, with the laws of these effects."""
    value = dict(zip(NAMES, numbers, strict=True))
    plain = spring_damper_rig(
        mass=value["mass_kg"],
        mu_s=value["mu_s"],
        k=value["k_N_per_m"],
        b=value["b_N_s_per_m"],
        mu_k_over_mu_s=value["mu_k_over_mu_s"],
        k_v=value["k_v_N_s_per_m"],
        stroke=value["stroke_m"],
    )
    keys: dict[str, dict] = {effect: {} for effect in ids}
    for name in NAMES[len(BASE) :]:
        effect, key = name.split(".")
        if effect in keys and name not in FIXED:
            keys[effect][GIVEN.get(name, key)] = value[name]
    return catalogue.extended(plain, keys), value["velocity_m_per_s"]


class Answers(NamedTuple):
    """Of n pushes; columns are F_p and d."""

    values: NDArray
    slopes: NDArray
    """(n, directions, 2)"""
    seen: Observables
    compiled: int
    """programs compiled after the first block"""

    def part(self, at: slice) -> Answers:
        """Some of the pushes."""
        some = jax.tree.map(lambda x: x[at], (self.values, self.slopes, self.seen))
        return Answers(*some, self.compiled)


@cache
def program(ids: Sequence[str], integrator=None, options=None):
    """(rows, directions) -> values, slopes along them, observables; compiled once for the laws."""

    def push(numbers, directions):
        def follow(numbers):
            rig, velocity = built(numbers, ids)
            seen = observe(rig, velocity, integrator)
            return jnp.stack([seen.peak_force, seen.sliding_distance]), seen

        def along(direction):
            return jax.jvp(follow, (numbers,), (direction,), has_aux=True)

        values, slopes, seen = jax.vmap(along)(directions)
        return values[0], slopes, jax.tree.map(lambda x: x[0], seen)

    return jax.jit(jax.vmap(push), compiler_options=dict(options) if options else None)


class Compilations:
    """Counts the programs that are compiled within it."""

    def __enter__(self):
        self.count = 0
        jax.monitoring.register_event_duration_secs_listener(self._heard)
        return self

    def _heard(self, event: str, duration: float, **more):
        self.count += event == "/jax/core/compile/backend_compile_duration"

    def __exit__(self, *_):
        jax.monitoring.unregister_event_duration_listener(self._heard)


def answers(ids, numbers, directions, integrator=None, quick=True) -> Answers:
    """The pushes of these rows, in blocks of pushes of about the same length.

    `quick`: the program is compiled quickly and runs slowly.
    """
    pushes = program(ids, integrator, tuple(OPTIONS.items()) if quick else None)
    n = len(numbers)
    order = np.argsort(_length(numbers), kind="stable")
    blocks = [np.resize(order[i : i + BLOCK], BLOCK) for i in range(0, n, BLOCK)]
    done = [jax.block_until_ready(pushes(numbers[blocks[0]], directions[blocks[0]]))]
    with Compilations() as later:
        for block in blocks[1:]:
            done.append(jax.block_until_ready(pushes(numbers[block], directions[block])))
    place = np.empty(n, int)
    place[order] = np.arange(n)

    def join(*parts):
        return np.concatenate([np.asarray(part) for part in parts])[place]

    return Answers(*jax.tree.map(join, *done), later.count)


def _length(numbers):
    """About how many steps a push takes: periods of the contact within it."""
    column = dict(zip(NAMES, numbers.T, strict=True))
    stroke = np.where(np.isfinite(column["stroke_m"]), column["stroke_m"], 0.0)
    period = np.sqrt(column["mass_kg"] / column["k_N_per_m"])
    return (stroke + column["initial_gap.gap_m"]) / column["velocity_m_per_s"] / period


class Errors(NamedTuple):
    """(n, 2) how far F_p and d are off, relatively; and their derivatives, relative to the push's
    largest logarithmic one. NaN where there is no d."""

    values: NDArray
    slopes: NDArray


def units(rows) -> NDArray:
    """(n, derivatives) directions that change one parameter each by its own size."""
    columns = [NAMES.index(name) for name in BY]
    size = np.abs(STORED["parameters"][rows][:, columns])
    size = np.where(np.isfinite(STORED["d_peak_force"][rows]), size, 0.0)
    found = np.zeros((len(rows), len(BY), len(NAMES)))
    found[:, np.arange(len(BY)), columns] = size
    return found


def stored(rows):
    """((n, 2) F_p and d, (n, derivatives, 2) their derivatives along `units`)."""
    values = np.stack([STORED["peak_force"][rows], STORED["sliding_distance"][rows]], axis=1)
    slopes = np.stack([STORED["d_peak_force"][rows], STORED["d_sliding_distance"][rows]], axis=2)
    return values, slopes * np.max(units(rows), axis=2)[..., None]


def errors(rows, weights, found: Answers) -> Errors:
    """Against the stored answers; slopes are along `weights` (n, directions, derivatives) times
    `units`."""
    values, slopes = stored(rows)
    known = np.where(np.isfinite(slopes), slopes, 0.0)
    largest = np.max(np.abs(known), axis=1)
    off = np.max(np.abs(found.slopes - weights @ known), axis=1)
    off = np.where(np.isnan(values), np.nan, off / np.where(largest > 0, largest, 1.0))
    return Errors(np.abs(found.values / values - 1), off)


def null_rows(rows) -> NDArray:
    """The same plain rigs without effects."""
    columns = {name: STORED["parameters"][rows][:, NAMES.index(name)] for name in BASE}
    return np.stack([vector({name: c[i] for name, c in columns.items()}) for i in range(len(rows))])
