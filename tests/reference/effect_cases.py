"""The stored pushes with effects, as `make_effect_cases` wrote them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .effect_parameters import TABLE

FILE = Path(__file__).with_name("effect_cases.npz")


@dataclass(frozen=True)
class Case:
    """One push: its parameters but for those at null, its answers and their derivatives."""

    group: str
    rig: dict[str, float]
    peak_force: float
    sliding_distance: float | None
    regime: str
    contacts: int
    sticks: int
    steps: int
    d_peak_force: dict[str, float]
    d_sliding_distance: dict[str, float]  # empty where the push has no d


def _there(names, row) -> dict[str, float]:
    return {str(name): float(x) for name, x in zip(names, row, strict=True) if not np.isnan(x)}


def load(file: Path = FILE) -> list[Case]:
    with np.load(file) as stored:
        f = dict(stored)
    cases = []
    for i, distance in enumerate(f["sliding_distance"]):
        rig = _there(f["names"], f["parameters"][i])
        cases.append(
            Case(
                group=str(f["groups"][f["group"][i]]),
                rig={name: x for name, x in rig.items() if x != TABLE[name]},
                peak_force=float(f["peak_force"][i]),
                sliding_distance=None if np.isnan(distance) else float(distance),
                regime=str(f["regimes"][f["regime"][i]]),
                contacts=int(f["contacts"][i]),
                sticks=int(f["sticks"][i]),
                steps=int(f["steps"][i]),
                d_peak_force=_there(f["derivative_names"], f["d_peak_force"][i]),
                d_sliding_distance=_there(f["derivative_names"], f["d_sliding_distance"][i]),
            )
        )
    return cases
