"""Which parameters a fit determines; which numbers the pushes say themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from difffric.errors import InputError
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.catalogue import CONTACT
from difffric.rig.setup import Setup

_OF_THE_CONTACT = tuple(
    name for name in parameters.OF_LAWS if parameters.PARAMETERS[name].component == CONTACT
)
"""Parameters of which a free slide, made without a pusher, says nothing."""
USUAL_SCATTER = 0.03
"""A scatter of mu_s from push to push that is taken where nobody says one: where its estimate
starts, and what a design of pushes expects."""


def has_gauge(pushes: Pushes) -> bool:
    """Whether a gauge said mu_s of every push."""
    return not np.isnan(pushes.mu_s_gauge).any()


def choose_free(setup: Setup, pushes: Pushes, asked: Sequence[str] | None) -> tuple[str, ...]:
    """The names of the parameters that a fit of these pushes determines.

    These are the ones that were asked for. Where nothing was asked for they are `parameters.FREE`
    and what the set-up's tables say is free, less mu_s where a gauge says it, and less what these
    pushes cannot show.

    Raises `InputError` where an empty list was asked for.
    """
    known = parameters.names(setup.rig)
    if asked is not None:
        chosen = tuple(dict.fromkeys(asked))
        if not chosen:
            raise InputError(f"free: expected some of {', '.join(known)}; got nothing")
        return chosen
    said = {name: extras.free for name, extras in setup.extras.items() if name in known}
    names = [name for name in parameters.FREE if said.get(name) is not False and name in known]
    names += [name for name, free in said.items() if free and name not in names]
    if has_gauge(pushes):
        names = [name for name in names if name != "mu_s"]
    if pushes.free_slides:
        names = [name for name in names if name not in _OF_THE_CONTACT]
    return tuple(names)


def collect_given(pushes: Pushes, free: Sequence[str]) -> dict[str, NDArray]:
    """What the pushes say of parameters, by name, (n,) each [SI]; NaN where a push does not.

    A gauge's mu_s counts only where mu_s is not free.
    """
    given = {"mass_kg": pushes.mass}
    if has_gauge(pushes) and "mu_s" not in free:
        given["mu_s"] = pushes.mu_s_gauge
    return given


def choose_first_scatter(
    setup: Setup, pushes: int, names: Sequence[str], notes: list[str]
) -> tuple[float, bool]:
    """The scatter of mu_s where it starts or stands, and whether it is to be estimated.

    `names` has the parameter behind each free column. Too few pushes add a line to `notes`.
    """
    said = setup.mu_s_scatter
    extras = setup.extras.get("friction.mu_s_scatter")
    columns = sum(name == "mu_s" for name in names)
    if columns == 0:
        return 0.0, False
    if extras is not None and extras.free is False:
        return said or 0.0, False
    if pushes < columns + 2:
        notes.append(
            "too few pushes to estimate the scatter of mu_s: "
            + (f"the set-up's {said:g} is taken" if said else "none is assumed")
        )
        return said or 0.0, False
    return said or USUAL_SCATTER, True
