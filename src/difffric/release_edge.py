"""The loss of contact: where a recorded force, falling, meets its level without contact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from difffric.contacts import Contact
from difffric.local_fit import (
    Estimate,
    LocalFit,
    Stretch,
    best_window,
    fit_window,
    powers,
    sizes,
)
from difffric.noise import Noise, whitening
from difffric.recordings import Channel


def find_release(force: Channel, coarse: Stretch, contact: Contact, noise: Noise) -> Estimate:
    """Where the force of a contact reaches the level after it; `value` is that level [N].

    A falling polynomial and a constant that meet: an edge fitted from both sides is neither
    early nor late, as a threshold on a noisy force is.
    """
    begin = contact.segments[-1][0]
    part = coarse.between(begin, contact.end)
    if len(part.t) > 3 and len(contact.segments) == 1:
        size = max(1, len(part.t) // 15)
        begin = float(part.t[int(np.argmax(np.convolve(part.y, np.ones(size), "same")))])
    flank = max(contact.end - begin, 4 * force.dt)
    stretch = Stretch.of(force, begin + 0.51 * force.dt, contact.end + 2 * flank, noise)
    fits: list[tuple[tuple[float, float], Estimate]] = []
    for share in (1.0, 0.4, 0.15, 0.05):  # the fall may be the last of a long contact only
        scale = share * flank
        if share < 1.0 and scale < 8 * stretch.dt:
            break
        start = _rough_edge(stretch, contact.end, 0.7 * scale)
        known = [edge for rank, edge in fits if rank[0] > 0]
        height = min(5 * stretch.noise.level, 0.5 * contact.top)
        latest = contact.end + max(0.25 * min(contact.width, flank), 0.1 * flank)
        if (fit := _edge(stretch, start, scale, latest, height, known)) is not None:
            fits.append(fit)
    if not fits:  # the force is lost at once: between two samples
        tail = stretch.y[-max(1, len(stretch.y) // 2) :]
        lost = contact.jumps[-1] if contact.jumps else contact.end
        return Estimate(float(np.mean(tail)), np.nan, lost, stretch.dt / np.sqrt(12))
    return max(fits, key=lambda f: f[0])[1]


def _edge(
    stretch: Stretch,
    edge: float,
    scale: float,
    latest: float,
    least_height: float,
    known: list[Estimate],
) -> tuple[tuple[float, float], Estimate] | None:
    """(rank, the edge near `edge`), unless that leads to one that is known.

    The rank is how well the fit passes and then the width of its window: not the error found for
    the edge, as noise that looks like a cliff makes that small.
    """
    lo, hi = edge - 0.5 * scale, min(edge + 0.5 * scale, latest)
    least = int(0.1 * scale / stretch.dt)  # shorter, and noise may look like an edge
    best = None
    for turn in range(4):
        i = int(np.searchsorted(stretch.t, edge))
        n = len(stretch.t) - i
        if i < 4 or n < 3:
            return None
        found = []
        for degree in (2, 3):
            fit = best_window(
                stretch,
                edge,
                scale,
                _edge_columns(degree, stretch.block / scale, step=True),
                _edge_extra(degree),
                left=sizes(min(max(degree + 1, least), i), i),
                right=sizes(min(max(6, least), n), n, 1.6),
                least=degree + 6,
                of=degree + 1,
            )
            if fit is not None:
                found.append((min(fit.passed, 0.03), -fit.se(degree + 1), degree, fit))
        if not found:
            return None
        _, _, degree, fit = max(found, key=lambda f: f[:2])
        posterior = _edge_posterior(stretch, fit, degree, (lo, hi), scale)
        if posterior is None:
            return best
        moved = abs(posterior[0] - edge)
        edge, spread = posterior
        high = stretch.y[fit.lo : fit.hi].max() - fit.coefficients[0]
        seen = spread < 0.1 * scale and high > least_height
        passed = fit.passed if seen else 0.0  # correlated noise, too, falls and then is level
        rank = (min(passed, 0.03), -fit.se(degree + 1))
        best = rank, Estimate(fit.coefficients[0], fit.se(), edge, spread)
        if any(abs(edge - other.time) < other.time_se / 2 for other in known):
            return None
        if turn > 0 and passed and moved < spread:
            break
    return best


def _edge_posterior(stretch, fit: LocalFit, degree, within, scale) -> tuple[float, float] | None:
    """Mean and standard deviation of the edge in the window of a fit; None: nothing falls there.

    The chi-square is not a parabola in the edge where it moves from sample to sample, least of
    all with correlated noise; the mean over it stays right. The prior is flat in the
    coefficients of the falling polynomial, and so goes with its slope at the edge.
    """
    t = stretch.t[fit.lo : fit.hi]
    lo, hi = max(within[0], t[min(degree, len(t) - 1)]), min(within[1], t[-2])
    if not hi > lo:
        return None
    birge = max(1.0, fit.reduced_chi2) if not fit.passed else 1.0
    edge = spread = np.nan
    for _ in range(12):
        edges = np.linspace(lo, hi, 31)
        chi2, slopes = _profile(stretch, fit, degree, edges, scale)
        falling = np.maximum(-slopes, 0.0)
        if not falling.any():
            return None
        excess = np.maximum(chi2 - chi2[falling > 0].min(), 0.0) / birge
        weight = falling * np.exp(-0.5 * excess)
        weight /= weight.sum()
        edge, step = float(weight @ edges), edges[1] - edges[0]
        spread = float(np.sqrt(weight @ (edges - edge) ** 2))
        if spread > 1.5 * step or step < 1e-9 * scale:
            break
        reach = max(8 * spread, 3 * step)
        lo, hi = max(lo, edge - reach), min(hi, edge + reach)
    return edge, spread


def _profile(stretch, fit: LocalFit, degree, edges, scale):
    """(chi-square, slope at the edge) with each of the `edges` in the window of a fit, at once."""
    t = stretch.t[fit.lo : fit.hi]
    s = ((t - edges[:, None]) / scale).ravel()
    columns = _edge_columns(degree, stretch.block / scale)(s).reshape(len(edges), len(t), -1)
    y = np.broadcast_to(stretch.y[fit.lo : fit.hi], columns.shape[:2])
    both = np.moveaxis(np.concatenate([columns, y[..., None]], axis=2), 1, 0)
    white = np.moveaxis(whitening(np.arange(len(t)), stretch.noise)(both), 0, 1)
    norms = np.linalg.norm(white, axis=1, keepdims=True)
    norms[norms == 0] = 1.0
    r: NDArray = np.asarray(np.linalg.qr(white / norms, mode="r"))
    upper = r[:, :-1, :-1] + 1e-14 * np.eye(degree + 1)
    coefficients = np.linalg.solve(upper, r[:, :-1, -1:])[..., 0]
    last = norms[:, 0, -1]
    return (r[:, -1, -1] * last) ** 2, coefficients[:, 1] * last / norms[:, 0, 1]


def _rough_edge(stretch: Stretch, end: float, flank: float) -> float:
    """The edge near `end` that a parabola of length `flank` and a level explain best."""
    near = stretch.between(end - flank, end + flank)
    if len(near.t) < 8:
        return end

    whole = fit_window(near, 0, len(near.t), end, flank, powers(0))
    edges = np.linspace(end - 0.8 * flank, end + 0.3 * flank, 40)
    return float(edges[int(np.argmin(_profile(near, whole, 2, edges, flank)[0]))])


def _edge_columns(degree, block, step=False):
    """The level, and powers of s before the edge (s < 0), averaged over each point's block; last
    a step there where asked for."""

    def columns(s):
        if block > 0:  # exactly: a mean across the edge is on neither side of it
            whole = powers(degree + 1)
            means = whole(np.minimum(s + block / 2, 0)) - whole(np.minimum(s - block / 2, 0))
            falling = means[:, 1:] / (block * np.arange(1, degree + 2))
            falling[:, 0] = 1.0
        else:
            falling = powers(degree)(np.minimum(s, 0.0))
        return np.concatenate([falling, (s < 0.0)[:, None]], axis=1) if step else falling

    return columns


def _edge_extra(degree):
    return lambda s, _: np.stack(
        [(s < 0) * s ** (degree + 1), (s < 0) * s ** (degree + 2), (s >= 0) * s], axis=1
    )
