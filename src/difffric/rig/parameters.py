"""Names of a rig's parameters, as files and results write them, and where they stand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from difffric.errors import InputError
from difffric.rig import catalogue
from difffric.rig.friction import innermost
from difffric.rig.pusher import ConstantSpeed
from difffric.rig.rig import Rig

RIG_PARAMETERS: dict[str, Callable[[Any], Any]] = {
    "mu_s": lambda rig: innermost(rig.friction).mu_s,
    "mu_k_over_mu_s": lambda rig: innermost(rig.friction).mu_k_over_mu_s,
    "k_v_N_s_per_m": lambda rig: innermost(rig.friction).k_v,
    "k_N_per_m": lambda rig: innermost(rig.contact).k,
    "b_N_s_per_m": lambda rig: innermost(rig.contact).b,
    "mass_kg": lambda rig: rig.mass,
}
"""SI parameters of the laws of equations (1) and (2). mu_k follows mu_s by the ratio."""


def names(rig: Rig) -> tuple[str, ...]:
    """The parameters that this rig's laws have."""

    def has(where):
        try:
            return where(rig) is not None
        except AttributeError:
            return False

    own = tuple(name for name, where in RIG_PARAMETERS.items() if has(where))
    return own + catalogue.parameter_names(rig)


def values(rig: Rig) -> dict[str, Any]:
    """Name -> value [SI]."""
    return {name: _value(rig, name) for name in names(rig)}


def _value(rig: Rig, name: str) -> Any:
    return RIG_PARAMETERS[name](rig) if name in RIG_PARAMETERS else catalogue.parameter(rig, name)


def _place(name: str):
    """(rig -> the number behind a name, how the rig has a value)."""
    if name in RIG_PARAMETERS:
        return RIG_PARAMETERS[name], lambda value: value
    return catalogue.where(name)


def with_values(rig: Rig, new: Mapping[str, Any]) -> Rig:
    """The rig with some parameters replaced.

    Raises `InputError` for a name that the rig does not have.
    """
    unknown = sorted(set(new) - set(names(rig)) - set(catalogue.GIVEN))
    if unknown:
        raise InputError(f"no such parameter: {', '.join(unknown)}; known: {', '.join(names(rig))}")
    if not new:
        return rig
    places = [_place(name) for name in new]
    numbers = [to_law(x) for (_, to_law), x in zip(places, new.values(), strict=True)]
    return eqx.tree_at(lambda r: [where(r) for where, _ in places], rig, numbers)


def with_stroke(rig: Rig, stroke) -> Rig:
    """The rig whose pusher stops after `stroke` [m]; None: at the first loss of contact."""
    return eqx.tree_at(lambda r: innermost(r.pusher), rig, ConstantSpeed(stroke))


def as_arrays(tree: Any) -> Any:
    """A rig (or what holds one) with every number an array, so that one compiled program serves
    all rigs."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


def spread(rig: Rig, n: int) -> Rig:
    """n copies of a rig in one, every number a NumPy array of that length, to be vmapped over."""

    def copies(leaf):
        return np.broadcast_to(np.asarray(leaf, float), (n,))

    return jax.tree.map(copies, rig)


def pick(tree: Any, index) -> Any:
    """Some entries of spread rigs (or of any tree of arrays), by an array of indices."""

    def entries(leaf):
        # NumPy's own stay so: to index one of JAX's takes a hundred times as long.
        return (leaf if isinstance(leaf, np.ndarray) else jnp.asarray(leaf))[index]

    return jax.tree.map(entries, tree)
