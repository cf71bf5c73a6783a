"""A ring on a rotary table: how far, and in which direction, its centre is off the axis.

A probe at a fixed place measures the ring's surface over a rotation. `angle` is what the table's
encoder reads; the radius there is the distance of the surface under the probe from the axis. A
circle of radius R whose centre is off by e towards the angle phi has, exactly,

    r(theta) = e cos(theta - phi) + sqrt((R + h)^2 - e^2 sin^2(theta - phi)),

with lobes h = sum a_n cos(n psi) + b_n sin(n psi), n >= 2, about the ring's own centre:
psi = theta + asin(e sin(theta - phi) / R).

**The direction of the push.** With the encoder at `direction` the centre lies from the axis
towards the probe, whichever way the table counts. So a tip that stands where the probe stands
pushes by `offset` towards the axis, at that encoder angle; the centre then is on the axis.

A first harmonic of the ring's form looks as an offset does, at every angle: no reading tells them
apart, and the offset found is the one to remove.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.centering.ring_fit import (
    Prior,
    RingFit,
    RingReadings,
    fit_circle,
    fit_ring,
    fit_robustly,
    predict,
    select_inliers,
)
from difffric.errors import InputError
from difffric.units import to_mm, to_um

FORM = 1e-6
"""Standard deviation [m] of each lobe's two amplitudes that a ring may have unless its readings
show larger ones: a ground ring's."""


@dataclass(frozen=True)
class Ring:
    """The offset of a ring's geometric centre from the axis, and what else its readings say."""

    x: float
    """part of the offset towards the encoder's zero [m]"""
    y: float
    """part of the offset towards 90 degrees [m]"""
    covariance: NDArray
    """(2, 2) of x and y [m^2]; what lobes, radius and noise make uncertain is in it"""
    radius: float
    """[m]"""
    radius_se: float
    noise: float
    """standard deviation of one reading [m]: given, or estimated"""
    lobes: NDArray
    """(orders - 1, 2): amplitudes [m] of cos(n psi) and sin(n psi), n = 2 upwards"""
    lobes_se: NDArray
    form: float
    """standard deviation of a lobe's amplitudes that was allowed for [m]; inf: they are free"""
    outliers: NDArray
    """indices of the readings that were left out as outliers"""
    missing: int
    """number of readings that are not numbers"""
    residuals: NDArray
    """(n,) measured less fitted [m]; NaN where the reading is"""
    reduced_chi2: float | None
    """None where the noise was estimated, as it is 1 then"""
    arc: float
    """what the readings span [rad]: a turn less the largest gap"""
    notes: tuple[str, ...] = ()

    @property
    def offset(self) -> float:
        """Distance of the geometric centre from the axis [m]."""
        return float(np.hypot(self.x, self.y))

    @property
    def direction(self) -> float:
        """Encoder angle at which the centre lies towards the probe [rad], from -pi to pi."""
        return float(np.arctan2(self.y, self.x))

    @property
    def offset_se(self) -> float:
        """Standard error of the offset [m], to first order."""
        u = np.array([np.cos(self.direction), np.sin(self.direction)])
        return float(np.sqrt(u @ self.covariance @ u))

    @property
    def direction_se(self) -> float:
        """Standard error of the direction [rad], to first order; inf without an offset."""
        u = np.array([-np.sin(self.direction), np.cos(self.direction)])
        across = float(np.sqrt(u @ self.covariance @ u))
        return across / self.offset if self.offset > 0 else float("inf")

    def as_dict(self) -> dict:
        """Return the ring as result.json holds it, in SI units."""
        orders = range(2, 2 + len(self.lobes))
        return {
            "offset_m": self.offset,
            "offset_standard_error_m": self.offset_se,
            "direction_rad": self.direction,
            "direction_standard_error_rad": self.direction_se,
            "x_m": self.x,
            "y_m": self.y,
            "covariance_m2": self.covariance,
            "radius_m": self.radius,
            "radius_standard_error_m": self.radius_se,
            "noise_m": self.noise,
            "form_m": self.form,
            "lobes": [
                {"order": n, "cos_m": c, "sin_m": s, "cos_se_m": dc, "sin_se_m": ds}
                for n, (c, s), (dc, ds) in zip(orders, self.lobes, self.lobes_se, strict=True)
            ],
            "readings": int(np.isfinite(self.residuals).sum()),
            "missing": self.missing,
            "outliers": self.outliers,
            "reduced_chi2": self.reduced_chi2,
            "arc_rad": self.arc,
            "notes": self.notes,
        }

    def __str__(self) -> str:
        lines = [
            f"offset {to_um(self.offset):.3f} ± {to_um(self.offset_se):.3f} µm towards "
            f"{np.degrees(self.direction):.3f} ± {np.degrees(self.direction_se):.3f} degrees",
            f"radius {to_mm(self.radius):.6f} ± {to_mm(self.radius_se):.6f} mm, noise "
            f"{to_um(self.noise):.3f} µm, {len(self.outliers)} outliers, "
            f"{np.degrees(self.arc):.0f} degrees",
        ]
        return "\n".join([*lines, *self.notes])


def measure(
    angle: ArrayLike,
    radius: ArrayLike,
    *,
    noise: float | None = None,
    lobes: int | None = None,
    form: float = FORM,
) -> Ring:
    """Find the offset of a ring from n readings: `angle` [rad], in any order, and `radius` [m].

    `noise` is the standard deviation of one reading [m], estimated unless given. `lobes` is the
    highest order of lobes; all from 2 to it are then free (1: there are none, the ring is round).
    Unless it is given, the readings choose the order, up to 16, and how large lobes are; `form` [m]
    is the least size that is allowed for, as on a short arc lobes look as an offset does, and the
    standard errors are to say so. NaN readings are missing; outliers (4 standard deviations) are
    left out and listed.

    Raises `InputError` for fewer than four usable readings or angles, lengths that differ,
    numbers out of range, and an offset not smaller than the radius.
    """
    theta, r = np.asarray(angle, float), np.asarray(radius, float)
    if theta.ndim != 1 or theta.shape != r.shape:
        raise InputError(
            f"ring: expected as many angles as radii, got shapes {theta.shape} and {r.shape}"
        )
    for name, value in (("noise", noise), ("form", form)):
        if value is not None and not (0 < value < np.inf or (name == "form" and value == 0)):
            raise InputError(f"ring: {name}: expected a number > 0 in metres, got {value:g}")
    if lobes is not None and not 1 <= lobes <= 100:
        raise InputError(f"ring: lobes: expected an order from 1 (none) to 100, got {lobes}")
    usable = np.isfinite(theta) & np.isfinite(r)
    t, y = theta[usable], r[usable]
    arc = _check_readings(t, y, lobes)
    data = RingReadings(np.cos(t), np.sin(t), t, y)
    free = None if lobes is None and form else Prior(lobes or 1, np.inf)
    first = free or Prior(min(8, max(1, (len(t) - 3) // 2)), 10 * form)
    p = np.zeros(first.size)
    p[:3] = fit_circle(data)
    p, weight = fit_robustly(data, p, first, noise)
    for _ in range(6):
        found = fit_ring(data, p, free, weight, noise, form)
        p = found.p
        kept = select_inliers(data, found)
        if (kept == (weight > 0)).all() or kept.sum() < 4:
            break
        weight = kept.astype(float)
    if not np.hypot(p[0], p[1]) < p[2]:
        raise InputError(
            f"ring: the readings give an offset of {to_mm(np.hypot(p[0], p[1])):.4g} mm, expected "
            f"less than the radius, {to_mm(p[2]):.4g} mm"
        )
    residuals = np.full(len(theta), np.nan)
    residuals[usable] = y - predict(data, p)[0]
    chi2 = float((weight * residuals[usable] ** 2).sum() / found.noise**2)
    se = np.sqrt(np.diag(found.covariance))
    return Ring(
        x=float(p[0]),
        y=float(p[1]),
        covariance=found.covariance[:2, :2],
        radius=float(p[2]),
        radius_se=float(se[2]),
        noise=found.noise,
        lobes=p[3:].reshape(-1, 2),
        lobes_se=se[3:].reshape(-1, 2),
        form=found.form,
        outliers=np.flatnonzero(usable)[weight == 0],
        missing=int((~usable).sum()),
        residuals=residuals,
        reduced_chi2=None if noise is None or found.freedom < 1 else chi2 / found.freedom,
        arc=arc,
        notes=_write_notes(data, found, weight, arc),
    )


def evaluate_surface(ring: Ring, angle: ArrayLike, lobes: bool = True) -> NDArray:
    """Return the fitted surface's radius [m] at encoder angles [rad], with lobes or without."""
    t = np.asarray(angle, float)
    p = np.concatenate([[ring.x, ring.y, ring.radius], ring.lobes.ravel() if lobes else []])
    return predict(RingReadings(np.cos(t), np.sin(t), t, t), p)[0]


def _check_readings(t: NDArray, r: NDArray, lobes: int | None) -> float:
    """Return the arc that readings r [m] at angles t [rad] span [rad].

    Raises `InputError` where they are too few for the lobes that are wanted, or not radii.
    """
    if len(t) < 4:
        raise InputError(
            f"ring: {len(t)} usable readings; expected at least 4, as offset and radius are 3 "
            "unknowns"
        )
    if (r <= 0).any():
        raise InputError(f"ring: expected radii > 0, got {r.min():g} m")
    at = np.unique(np.round(np.mod(t, 2 * np.pi), 9))
    if len(at) < 4:
        raise InputError(f"ring: {len(at)} different angles; expected at least 4 around the ring")
    least = 1 + Prior(lobes or 1, np.inf).size
    if len(at) < least:
        raise InputError(
            f"ring: {len(at)} different angles; expected at least {least} for lobes up to the "
            f"order {lobes}"
        )
    return float(2 * np.pi - np.diff(at, append=at[0] + 2 * np.pi).max())


def _write_notes(data: RingReadings, fit: RingFit, weight: NDArray, arc: float) -> tuple[str, ...]:
    """Return what a person should know of a fit: an arc that is too short, many outliers."""
    notes = []
    if len(fit.p) > 3:
        by = predict(data, fit.p)[1][:, :3]
        round_only = fit.noise**2 * np.linalg.pinv((by * weight[:, None]).T @ by, hermitian=True)
        ratio = np.sqrt(np.trace(fit.covariance[:2, :2]) / np.trace(round_only[:2, :2]))
        if ratio > 2:
            lobes = "free lobes" if fit.form == np.inf else f"lobes of {to_um(fit.form):.2g} µm"
            notes.append(
                f"an arc of {np.degrees(arc):.0f} degrees is too short to tell {lobes} from an "
                f"offset: its standard error is {ratio:.3g} times that of a round ring"
            )
    out = float((weight == 0).mean())
    if out > 0.1:
        notes.append(f"{100 * out:.0f} % of the readings are outliers")
    return tuple(notes)
