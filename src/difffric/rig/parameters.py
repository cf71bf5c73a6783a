"""What is known of a rig's parameters: one table, and the values that a rig has of them.

Each parameter of equations (1) and (2), and each number of an effect (`id.key`), is a row of
`PARAMETERS`: its name as files and results write it, where it stands in a rig, its unit and range,
and how a calibration moves it. To add a parameter of a new law, add a line to `_OF_LAWS`; those of
an effect come from its line in the catalogue.

A rig's numbers are best read once and put back once: `unpack` gives the values and the function
that puts others in their place; `with_values` puts some in, `override` those that were given,
`with_push` all that a push's record says, `setter` the same names again and again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from difffric.compute.number_tree import put_parts
from difffric.errors import InputError
from difffric.rig import catalogue
from difffric.rig.catalogue import Effect, Key
from difffric.rig.friction import innermost
from difffric.rig.pusher import make_pusher
from difffric.rig.rig import Rig
from difffric.value_ranges import NOT_NEGATIVE, POSITIVE, RATIO, Range

PART = "part"
"""The component that the mass belongs to; the others are the catalogue's."""


@dataclass(frozen=True)
class Parameter:
    """One number of a rig: what files, fits and texts know of it."""

    name: str
    """as files and results write it, with its unit"""
    component: str
    """`part`, or a component of the catalogue: `friction`, `contact`, ..."""
    at: Callable[[Any], Any]
    """the law's own number in a rig"""
    unit: str = ""
    """of its SI value, as texts write it; empty: a pure number"""
    range: Range = POSITIVE
    """what a file may say"""
    lower: float = 0.0
    upper: float = math.inf
    """the values [SI] between which a fit moves it"""
    step: float | None = None
    """the unit step [SI] of one that a fit moves on a linear scale, as it may be zero; None: it
    moves as its logarithm"""
    zero: float = 1e-2
    """a fit that ends at a bound, up to this value [SI], tells that the parameter is zero"""
    may_vanish: bool = False
    """whether a fit may run towards zero without end, where its logarithm has none"""
    free: int | None = None
    """its place among those that a calibration determines unless told otherwise; None: it is not
    among them"""
    roughness: float | None = None
    """the factor by which a rough guess may be off: a fit starts there too"""
    key: Key | None = None
    """its entry in the catalogue, if it is an effect's"""

    def to_law(self, value: Any) -> Any:
        """The law's number for a value [SI], and the value for the law's number: the inverse,
        where the law holds the inverse."""
        return value if self.key is None else self.key.to_law(value)


# mu_k follows mu_s by the ratio.
_OF_LAWS = (
    Parameter(
        "mu_s",
        catalogue.FRICTION,
        lambda rig: innermost(rig.friction).mu_s,
        zero=0.0,
        free=3,
        roughness=2.0,
    ),
    Parameter(
        "mu_k_over_mu_s",
        catalogue.FRICTION,
        lambda rig: innermost(rig.friction).mu_k_over_mu_s,
        range=RATIO,
        upper=1.0,
        zero=0.0,
    ),
    Parameter(
        "k_v_N_s_per_m",
        catalogue.FRICTION,
        lambda rig: innermost(rig.friction).k_v,
        unit="N s/m",
        range=NOT_NEGATIVE,
        step=10.0,
        free=2,
    ),
    Parameter(
        "k_N_per_m",
        catalogue.CONTACT,
        lambda rig: innermost(rig.contact).k,
        unit="N/m",
        free=0,
        roughness=3.0,
    ),
    Parameter(
        "b_N_s_per_m",
        catalogue.CONTACT,
        lambda rig: innermost(rig.contact).b,
        unit="N s/m",
        range=NOT_NEGATIVE,
        may_vanish=True,
        free=1,
        roughness=3.0,
    ),
    Parameter("mass_kg", PART, lambda rig: rig.mass, unit="kg"),
)
"""The parameters of the laws of equations (1) and (2), in the order of a fit's coordinates."""


def range_of(name: str, key: Key) -> Range:
    """What a file may say of an effect's number: what lies between the key's bounds, which a fit
    may reach; but laws divide by what is at its null elsewhere than at zero."""
    lower, upper = key.lower, key.upper
    # A patch may start where the part does. Bristles have no null.
    above = lower == 0 and key.null != 0 and name != "friction_patch.start_m"
    infinite = math.isinf(key.null) and name != "presliding.sigma_0_N_per_m"
    words = [f"{'>' if above else '>='} {lower:g}"] if math.isfinite(lower) else []
    words += [f"<= {upper:g}"] if math.isfinite(upper) else []
    return Range(
        " and ".join(words) + (", or inf" if infinite else ""),
        lambda x: ((x > lower) if above else (x >= lower)) & (x <= upper),
        infinite,
    )


_UNITS = {
    "_N_s2_per_m2": "N s2/m2",
    "_m_per_s2": "m/s2",
    "_N_s_per_m": "N s/m",
    "_N_per_m": "N/m",
    "_m_per_s": "m/s",
    "_rad": "rad",
    "_Hz": "Hz",
    "_N": "N",
    "_m": "m",
    "_s": "s",
}
"""How the name of an effect's key ends -> its unit in texts; longer endings first."""


def _of_effect(effect: Effect, key: Key) -> Parameter:
    """The row of one number of an effect. It moves on a linear scale, as its null is mostly zero,
    in steps of its typical size; where the law holds the inverse, as its logarithm."""
    name = f"{effect.id}.{key.name}"
    return Parameter(
        name,
        effect.component,
        catalogue.where(name)[0],
        unit=next((unit for end, unit in _UNITS.items() if key.name.endswith(end)), ""),
        range=range_of(name, key),
        lower=key.lower,
        upper=key.upper,
        step=None if key.inverse else key.typical or 1.0,
        key=key,
    )


PARAMETERS: dict[str, Parameter] = {row.name: row for row in _OF_LAWS} | {
    name: _of_effect(effect, key) for name, (effect, key) in catalogue.KEYS.items()
}
"""Name -> all that is known of the parameter."""

OF_LAWS = tuple(row.name for row in _OF_LAWS if row.component != PART)
"""The parameters of the laws of friction and contact; the mass is the part's, and each push says
it."""

FREE = tuple(
    row.name
    for row in sorted((row for row in _OF_LAWS if row.free is not None), key=lambda r: r.free or 0)
)
"""What a calibration determines unless told otherwise, in the order of its results."""


def names(rig: Rig) -> tuple[str, ...]:
    """The parameters that this rig's laws have, in the table's order."""

    def has(row: Parameter) -> bool:
        try:
            return row.at(rig) is not None
        except AttributeError:
            return False

    own = tuple(row.name for row in PARAMETERS.values() if row.key is None and has(row))
    return own + catalogue.parameter_names(rig)


def values(rig: Rig) -> dict[str, Any]:
    """Name -> value [SI]."""
    return {name: _read(rig, name) for name in names(rig)}


def _read(rig: Rig, name: str) -> Any:
    row = PARAMETERS[name]
    return row.to_law(row.at(rig))


def unpack(rig: Rig) -> tuple[dict[str, Any], Callable[[Mapping[str, Any]], Rig]]:
    """The values [SI] of all parameters by name, and the function that gives the rig with others
    in their place, as `jax.flatten_util.ravel_pytree` does; traceable.

    The function takes all of them or some, and asks no names any more.
    """
    return values(rig), lambda new: _put(rig, new)


def setter(rig: Rig, chosen: Sequence[str]) -> Callable[..., Rig]:
    """The function that gives the rig with the values [SI] of `chosen` parameters, in that order.

    Raises `InputError` for a name that the rig does not have.
    """
    _check(rig, chosen)
    return lambda *given: _put(rig, dict(zip(chosen, given, strict=True)))


def with_values(rig: Rig, new: Mapping[str, Any]) -> Rig:
    """The rig with some parameters replaced by values [SI], or by what a push's record says of an
    effect (`catalogue.GIVEN`).

    Raises `InputError` for a name that the rig does not have.
    """
    _check(rig, new)
    return _put(rig, new)


def override(rig: Rig, given: Mapping[str, Any], stroke: Any = None) -> Rig:
    """The rig with the values [SI] that are given in place of its own, and the pusher's stroke
    [m]; what is None stays as it is.

    Raises `InputError` for a name that the rig does not have.
    """
    new = {name: value for name, value in given.items() if value is not None}
    if new:
        rig = with_values(rig, new)
    return rig if stroke is None else with_stroke(rig, stroke)


def with_push(rig: Rig, numbers: Mapping[str, Any], stroke: Any) -> Rig:
    """The rig of one push: with the laws' own numbers replaced, by parameter name (the inverse of
    an acceleration, for example, whose null is 0 and not infinite), and the pusher's stroke [m] or
    recorded motion.

    The names are not checked.
    """
    places = [_place(name)[0] for name in numbers]
    return put_parts(
        rig,
        lambda r: [*(at(r) for at in places), innermost(r.pusher)],
        [*numbers.values(), make_pusher(stroke)],
    )


def _check(rig: Rig, chosen: Mapping[str, Any] | Sequence[str]) -> None:
    known = names(rig)
    unknown = sorted(set(chosen) - set(known) - set(catalogue.GIVEN))
    if unknown:
        raise InputError(f"no such parameter: {', '.join(unknown)}; known: {', '.join(known)}")


def _put(rig: Rig, new: Mapping[str, Any]) -> Rig:
    if not new:
        return rig
    places = [_place(name) for name in new]
    numbers = [to_law(x) for (_, to_law), x in zip(places, new.values(), strict=True)]
    return put_parts(rig, lambda r: [at(r) for at, _ in places], numbers)


def _place(name: str) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """(rig -> the number behind a name, how the law has a value)."""
    if name in PARAMETERS:
        row = PARAMETERS[name]
        return row.at, row.to_law
    return catalogue.where(name)


def with_stroke(rig: Rig, stroke: Any) -> Rig:
    """The rig whose pusher stops after `stroke` [m]; None: at the first loss of contact. A recorded
    motion may stand for the stroke: the tip then moves so."""
    return put_parts(rig, lambda r: [innermost(r.pusher)], [make_pusher(stroke)])
