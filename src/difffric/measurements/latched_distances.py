"""Where a card's latch would count d from another loss of contact than the last one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from difffric.measurements.reduction.reduce import Reduction
from difffric.number_text import format_number
from difffric.units import to_um

_SEEN = 5.0
"""Standard errors of d by which a latch's distance must be longer to be told."""


def describe_latch(reduction: Reduction) -> tuple[str, ...]:
    """A note of how far a latch at the first loss of contact would be from d; none where contact is
    lost once in every push.

    A card that latches the first fall of the force counts what the part is pushed on later as
    sliding (the effect `release_latch` of a table).
    """
    apart = _list_differences(reduction)
    several = np.flatnonzero(np.isfinite(apart))
    if not len(several):
        return ()
    worst = int(several[np.argmax(apart[several])])
    name = reduction.recordings[worst].name or f"push {worst}"
    most = format_number(to_um(apart[worst]), 3)
    return (
        f"{len(several)} of {len(apart)} pushes lose contact more than once: d is counted from the "
        f"last loss; counted from the first one, d would be up to {most} µm longer ({name})",
    )


def _list_differences(reduction: Reduction) -> np.ndarray:
    """The latch's distance less d (n,) [m]; NaN where there is no d, or no difference is seen."""
    details: Sequence = reduction.details
    apart = np.array([r.latched_distance - r.sliding_distance for r in details], float)
    least = _SEEN * np.array([r.sliding_distance_se for r in details], float)
    return np.where(apart > least, apart, np.nan)
