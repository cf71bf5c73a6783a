"""The paper's Tables I-V as printed, its own formulas, and where the two differ.

"Real-Time Identification of Sliding Friction Using LabVIEW FPGA". The tables lie beside this
module; signs of Table V's errors are ours, the paper prints magnitudes.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from difffric.identification.surrogates import PUBLISHED_DISTANCE, PUBLISHED_FORCE, weigh_by_ranges
from difffric.measurements.pushes import Pushes
from difffric.rig.rig import Rig, spring_damper_rig
from difffric.simulation.families import MU_S, SPEEDS_MM_MIN
from difffric.units import UM, from_mm_min

CONDITIONS = ("DRY", "OILY")
PRINTED_WITHIN = 1e-3
"""A printed mu_s further than this from its own formula is a misprint (it has 3 decimals)."""
LEAST_ERRORS = 3.0, 15 * UM
"""Standard errors of a measured F_p [N] and d [m] that are assumed: the paper states none."""
SHARE = 0.02
"""What is assumed beside them, as a share of the number."""


@dataclass(frozen=True)
class Printed:
    """One printed row of Tables I-V."""

    table: str
    condition: str
    velocity_mm_min: float
    mu_s_gauge: float
    quantity: str
    measured: float | None
    mu_s_printed: float | None
    error_percent_printed: float | None


def read_tables() -> list[Printed]:
    """Read Tables I-V as printed, 26 rows in their order."""
    text = (
        resources.files("difffric.studies").joinpath("paper_tables.csv").read_text(encoding="utf-8")
    )
    return [
        Printed(
            row["table"],
            row["condition"],
            float(row["velocity_mm_min"]),
            float(row["mu_s_gauge"]),
            row["quantity"],
            float(row["measured"]) if row["measured"] else None,
            float(row["mu_s_printed"]),
            float(row["error_percent_printed"]),
        )
        for row in csv.DictReader(text.splitlines())
    ]


def assume_errors(peak_force: NDArray, sliding_distance: NDArray) -> tuple[NDArray, NDArray]:
    """The standard errors [N], [m] that are assumed of measured F_p and d."""
    both = zip(LEAST_ERRORS, (peak_force, sliding_distance), strict=True)
    F, d = (np.hypot(least, SHARE * number) for least, number in both)
    return F, d


def load_pushes() -> Pushes:
    """Return the 12 pushes behind Tables I-IV: DRY at six speeds, then OILY."""
    rows = read_tables()
    force, distance = (
        {(r.condition, r.velocity_mm_min): r for r in rows if r.quantity == quantity}
        for quantity in ("peak_force_N", "sliding_distance_um")
    )
    F = np.array([r.measured for r in force.values()], float)
    d = UM * np.array([distance[key].measured for key in force], float)
    return Pushes(
        velocity=from_mm_min(np.array([v for _, v in force])),
        peak_force=F,
        sliding_distance=d,
        mu_s_gauge=np.array([r.mu_s_gauge for r in force.values()]),
        condition=[condition for condition, _ in force],
    )


def guess_rig(stroke: float | None = None) -> Rig:
    """Return the paper's part with a first guess of what is not printed: k from equation (3)'s
    slope, C_v = sqrt(k m), and b from a damping ratio of 0.2. `stroke` is in metres."""
    mass = 18.9
    C_v = PUBLISHED_FORCE.C_v / from_mm_min(1.0)
    k = C_v**2 / mass
    return spring_damper_rig(
        mass=mass, mu_s=0.141, k=k, b=0.4 * np.sqrt(k * mass), k_v=5.0, stroke=stroke
    )


def invert_surrogate(row: Printed) -> float | None:
    """Return a measurement's mu_s by the published equation (4) or (6); None: not measured."""
    v = from_mm_min(row.velocity_mm_min)
    if row.measured is None:
        return None
    if row.quantity == "peak_force_N":
        return float(PUBLISHED_FORCE.mu_s(v, row.measured))
    return float(PUBLISHED_DISTANCE.mu_s(v, row.measured * UM))


def compute_published_ratio() -> float:
    """Return equation (7)'s ratio of ranges [N/m], of the published (3) and (5) over 500-5000
    mm/min and mu_s of 0.05-0.30."""
    v, mu = np.meshgrid(from_mm_min(SPEEDS_MM_MIN), MU_S)
    F, d = PUBLISHED_FORCE.peak_force(v, mu), PUBLISHED_DISTANCE.sliding_distance(v, mu)
    return float(np.ptp(F) / np.ptp(d))


def combine_surrogates(
    velocity: NDArray, peak_force: NDArray, sliding_distance: NDArray, ratio: float
) -> NDArray:
    """Return mu_s (n,) by equations (4), (6) and (7) as published, in SI units."""
    mu_F = PUBLISHED_FORCE.mu_s(velocity, peak_force)
    mu_d = PUBLISHED_DISTANCE.mu_s(velocity, sliding_distance)
    dF, dd = PUBLISHED_FORCE.slope(velocity, mu_F), PUBLISHED_DISTANCE.slope(velocity, mu_d)
    return weigh_by_ranges(mu_F, mu_d, dF, dd, ratio)[0]


def find_misprints() -> list[dict]:
    """List the printed mu_s that their own formula does not give."""
    return [
        {
            "table": r.table,
            "velocity_mm_min": r.velocity_mm_min,
            "printed": r.mu_s_printed,
            "recomputed": value,
        }
        for r in read_tables()
        if (value := invert_surrogate(r)) is not None
        and r.mu_s_printed is not None
        and abs(value - r.mu_s_printed) > PRINTED_WITHIN
    ]
