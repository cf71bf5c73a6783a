"""The peak, the free slide and the rest of a recorded push, each with its standard error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial

from difffric.errors import InputError
from difffric.measurements.noise import Noise, count_still
from difffric.measurements.recordings import Channel
from difffric.measurements.reduction.contacts import Contact
from difffric.measurements.reduction.local_polynomials import (
    LocalEstimate,
    LocalFit,
    Stretch,
    best_window,
    fit_window,
    powers,
    sizes,
)

POINT = 5e-5
"""Time resolution of a search [s]; estimates use the samples themselves."""
_WIDER = (2.0, 1.5, 1.2)
"""Times what looks still at the end that are searched for a motion too slow to show in it; fewer
where a slip before it does not belong to that motion."""
_SMOOTH = 2.0
"""A reduced chi-square up to which a parabola is a motion that slows down."""


def coarsen(channel: Channel, noise: Noise) -> Stretch:
    """The whole channel at the resolution of a search. Raises `InputError` for NaN and inf."""
    most = max(1, int(channel.n * channel.dt / POINT))
    found = Stretch.of(channel, -np.inf, np.inf, noise, most)
    bad = ~np.isfinite(found.y)
    if bad.any():
        t = found.t[int(np.argmax(bad))]
        raise InputError(f"a sample in {channel.unit} near t = {t:.6g} s is not a finite number")
    return found


def _both(stretch: Stretch, centre: float, least: int) -> dict:
    """Window sizes left and right of `centre`, up to the stretch's ends."""
    i = int(np.searchsorted(stretch.t, centre))
    n = len(stretch.t) - i
    return {"left": sizes(min(least, i), i), "right": sizes(min(least, n), n)}


def _peak_in(force, a, b, noise, centre, width, limits) -> LocalEstimate | None:
    """The maximum of the force between the jumps (or edges) a and b, searched near `centre`.

    `limits`: (a, b) where the force there is one-sided and may itself be the maximum, else nan.
    """
    stretch = Stretch.of(force, max(a, centre - width), min(b, centre + width), noise)
    if len(stretch.t) < 3:
        return None
    beside = 1.01 * force.dt if len(stretch.t) > 12 else 0.51 * force.dt
    stretch = stretch.between(a + beside - force.dt / 2, b - beside + force.dt / 2)
    if len(stretch.t) < 3:
        return None
    degree = 4
    scale = max(width, force.dt)
    keep = [
        n for n, t in zip((0, len(stretch.t)), limits, strict=True) if abs(t - centre) < 0.2 * width
    ]
    best = None
    for _ in range(4):
        fit = best_window(
            stretch,
            centre,
            scale,
            powers(degree),
            _peak_extra(degree),
            **_both(stretch, centre, 2),
            least=degree + 6,
            keep=keep,
        )
        if fit is None:
            n = len(stretch.t)
            fit = fit_window(stretch, 0, n, centre, scale, powers(min(2, n - 2)))
        best, settled = _top(fit, stretch, centre, scale, limits, force.dt)
        if settled or abs(best.time - centre) < stretch.dt / 2:
            break
        centre = best.time
    return best


def _peak_extra(degree):
    """A higher power, and a kink on either side: the damper lets go soon after the peak."""
    return lambda s, first, last: np.stack(
        [s ** (degree + 1), np.maximum(s - 0.3 * last, 0), np.maximum(0.3 * first - s, 0)],
        axis=-1,
    )


def _top(fit: LocalFit, stretch, centre, scale, limits, dt) -> tuple[LocalEstimate, bool]:
    """The fitted polynomial's maximum, and whether it lies inside the window or at a jump."""
    a, slope = fit.coefficients, polynomial.polyder(fit.coefficients)
    ends = [stretch.t[fit.lo], stretch.t[fit.hi - 1]]
    at_jump = [False, False]
    if fit.lo == 0 and np.isfinite(limits[0]):
        ends[0], at_jump[0] = limits[0], True
    if fit.hi == len(stretch.t) and np.isfinite(limits[1]):
        ends[1], at_jump[1] = limits[1], True
    s_0, s_1 = ((t - centre) / scale for t in ends)
    roots = polynomial.polyroots(slope) if len(slope) > 1 else np.empty(0)
    real = [float(r.real) for r in roots if abs(r.imag) < 1e-9 and s_0 < r.real < s_1]
    values = [(float(polynomial.polyval(s, a)), s, None) for s in real]
    values += [
        (float(polynomial.polyval(s, a)), s, jump)
        for s, jump in zip((s_0, s_1), at_jump, strict=True)
    ]
    value, s, jump = max(values, key=lambda v: v[0])
    row = s ** np.arange(len(a))
    variance = float(row @ fit.covariance @ row)
    if jump is None:
        # The vertex of a noisy parabola is too high by var(slope) / (2 |curvature|).
        steep = np.concatenate([[0.0], np.arange(1, len(a)) * s ** np.arange(len(a) - 1)])
        bend = float(polynomial.polyval(s, polynomial.polyder(a, 2)))
        spread = float(steep @ fit.covariance @ steep)
        if bend < 0:
            value -= min(spread / (2 * -bend), np.sqrt(variance))
    elif jump and limits[0] != 0.0:  # where between two samples the jump is, is not known
        variance += (float(polynomial.polyval(s, slope)) / scale * dt) ** 2 / 12
    time = centre + s * scale
    return LocalEstimate(value, float(np.sqrt(variance)), time), jump is None or jump


def find_peak(
    force: Channel, coarse: Stretch, contacts: list[Contact], noise: Noise
) -> LocalEstimate:
    """The force's largest value [N], in whichever contact and between whichever jumps it is."""
    pieces = []
    for contact in contacts:
        size = max(1, int(contact.width / coarse.dt) // 15)
        for i, (a, b) in enumerate(contact.segments):
            part = coarse.between(a, b)
            if len(part.t) == 0:
                continue
            n = min(size, len(part.t))
            smooth = np.convolve(part.y, np.ones(n) / n, "valid")
            j = int(np.argmax(smooth))
            jumps_a, jumps_b = i > 0 or contact.struck, i < len(contact.jumps)
            centre = float(part.t[j] + part.t[j + n - 1]) / 2
            a_is = 0.0 if i == 0 and abs(a) <= coarse.dt else a
            limits = (a_is if jumps_a else np.nan, b if jumps_b else np.nan)
            if j == 0 and jumps_a:
                centre = a_is
            elif j == len(smooth) - 1 and jumps_b:
                centre = b
            pieces.append((float(smooth[j]), a, b, centre, contact.width, limits))
    largest = max(p[0] for p in pieces)
    found = [
        estimate
        for top, a, b, centre, width, limits in pieces
        if top > 0.85 * largest
        and (estimate := _peak_in(force, a, b, noise, centre, width, limits)) is not None
    ]
    return max(found, key=lambda e: e.value) if found else LocalEstimate(np.nan, np.nan, np.nan)


class Slide(NamedTuple):
    """The free slide's start, from the position."""

    position: float
    position_se: float
    velocity: float
    velocity_se: float
    acceleration: float
    deceleration: float
    deceleration_se: float


def find_slide(position: Channel, edge: float, begin: float, stop: float, noise: Noise):
    """Position, speed and acceleration at the release `edge`, and the mean deceleration up to
    `stop`; None where there are too few samples. The force, and with it the acceleration, has a
    kink there: each side has a cubic term of its own."""
    stretch = Stretch.of(position, min(begin, edge), max(stop, edge), noise)
    scale = max(stop - edge, 8 * position.dt)
    fit = best_window(
        stretch,
        edge,
        scale,
        lambda s: np.concatenate([powers(2)(s), _sides(s, 3)], axis=-1),
        lambda s, *_: _sides(s, 4),
        **_both(stretch, edge, 3),
        least=10,
        nested=True,
    )
    if fit is None:
        return None
    x, u, a = fit.coefficients[:3] / scale ** np.arange(3)
    i = int(np.searchsorted(stretch.t, edge))
    whole = None
    if len(stretch.t) - i >= 8:
        whole = fit_window(
            stretch, i, len(stretch.t), edge, scale, powers(2), lambda s, *_: powers(4, 3)(s)
        )
    mean = (np.nan, np.nan)
    if whole is not None:
        mean = (-2 * whole.coefficients[2] / scale**2, 2 * whole.se(2) / scale**2)
    return Slide(x, fit.se(0), u, fit.se(1) / scale, 2 * a, *map(float, mean))


def _sides(s, power):
    return np.stack([(s < 0) * s**power, (s >= 0) * s**power], axis=-1)


def find_rest(position: Channel, noise: Noise, velocity: float) -> LocalEstimate | None:
    """The rest position [m] and the time from which no motion is seen; None while it moves."""
    coarse = coarsen(position, noise)
    n = len(coarse.t)
    still = count_still(coarse.y, coarse.noise)
    if still < 8:
        return None
    centre = coarse.t[-1]
    for share in _WIDER:
        wide = min(max(int(share * still), 16), n)
        scale = centre - coarse.t[n - wide]
        fit = fit_window(coarse, n - wide, n, centre, scale, powers(2))
        if fit.reduced_chi2 < _SMOOTH:
            speed, se = fit.coefficients[1] / scale, fit.se(1) / scale
            if speed > max(4 * se, 1e-3 * velocity):
                return None
            break
    # The first part of what looks still may hide the last of the motion.
    mean = fit_window(coarse, n - max(8, int(0.8 * still)), n, centre, scale, powers(0))
    return LocalEstimate(mean.coefficients[0], mean.se(), coarse.t[n - still])
